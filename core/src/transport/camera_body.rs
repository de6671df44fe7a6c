//! The camera's housing and lens as an obstacle between lamp and sample.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::{Camera, Light, Scene};

/// Housing and lens as a cylinder around the optical axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraBody {
    /// Its radius, millimetres; > 0.
    pub radius_mm: f64,
    /// From its front away from the sample, millimetres; > 0.
    pub length_mm: f64,
    /// How far its front lies in front of the camera's position, towards the sample,
    /// millimetres; less than the sample's distance.
    pub front_mm: f64,
}

impl CameraBody {
    /// Whether it meets the line from a point in a direction (unit) up to a distance, all in
    /// the camera's frame, which looks along +z, millimetres.
    pub fn meets(&self, from_mm: DVec3, direction: DVec3, distance_mm: f64) -> bool {
        let ends_mm = [self.front_mm - self.length_mm, self.front_mm];
        let between = within_slab(from_mm.z, direction.z, ends_mm);
        let inside = within_circle(from_mm.truncate(), direction.truncate(), self.radius_mm);
        let [near_mm, far_mm] = overlap(overlap(between, inside), [0.0, distance_mm]);
        near_mm < far_mm
    }
}

/// Where `from + t along` is between two values, as an interval of t; empty where the first
/// end is not below the second.
fn within_slab(from: f64, along: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    if along.abs() < 1e-12 {
        return everywhere_if(low < from && from < high);
    }
    let ends = [(low - from) / along, (high - from) / along];
    [ends[0].min(ends[1]), ends[0].max(ends[1])]
}

/// Where `from + t along` is within a circle around 0, as an interval of t.
fn within_circle(from: DVec2, along: DVec2, radius: f64) -> [f64; 2] {
    let square = along.length_squared();
    if square < 1e-24 {
        return everywhere_if(from.length() < radius);
    }
    let nearest = -from.dot(along) / square;
    let miss = (from + nearest * along).length_squared();
    let half_chord = ((radius * radius - miss).max(0.0) / square).sqrt();
    [nearest - half_chord, nearest + half_chord]
}

fn everywhere_if(inside: bool) -> [f64; 2] {
    match inside {
        true => [f64::NEG_INFINITY, f64::INFINITY],
        false => [0.0, 0.0],
    }
}

fn overlap(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].max(b[0]), a[1].min(b[1])]
}

/// Why light from a direction does not light everything that the camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Obstruction {
    /// The camera's body stands between the lamp and the sample.
    Shadow {
        /// Part of the lines from what is seen of the sample to the lamp that it cuts, above 0.
        part: f64,
    },
    /// The lamp stands between the camera and the sample, in the image.
    LampInView,
}

impl std::fmt::Display for Obstruction {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            // At least something, however little it is.
            Self::Shadow { part } => write!(
                out,
                "the camera's body keeps the light from {:.0}% of the sample in view",
                (100.0 * part).max(1.0)
            ),
            Self::LampInView => write!(out, "the lamp stands in front of the camera, in its view"),
        }
    }
}

/// A camera's body, and the positions of the sample that it must not keep light from.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraShadow {
    camera: Camera,
    body: CameraBody,
    /// What the camera sees of the sample, camera frame.
    positions_mm: Vec<DVec3>,
    /// A ball around them, camera frame.
    middle_mm: DVec3,
    reach_mm: f64,
}

/// Places looked at along the longer side of the image.
const PLACES: usize = 64;
/// Rings of an extended lamp's disc are no farther apart than this, radians: 1.5°.
const RING_RAD: f64 = 0.026;
/// Points of a ring.
const RING_POINTS: usize = 24;

impl CameraShadow {
    /// Of the camera of a scene, whose lights do not count.
    pub fn new(scene: &Scene, body: CameraBody) -> Self {
        let camera = scene.camera;
        let to_camera = camera.sample_from_camera.inverse();
        let [width, height] = camera.resolution_px.map(|side| side as f64);
        let step_px = width.max(height) / PLACES as f64;
        let [columns, rows] = [width, height].map(|side| (side / step_px).ceil() as usize);
        let mut positions_mm = Vec::new();
        for position in 0..columns * rows {
            let cell = DVec2::new((position % columns) as f64, (position / columns) as f64);
            let at_px = ((cell + 0.5) * step_px).min(DVec2::new(width, height));
            let hit = scene.first(&camera.ray(at_px, DVec2::ZERO));
            if let Some((surface, _)) = hit.filter(|(surface, _)| surface.is_sample()) {
                positions_mm.push(to_camera.point(surface.origin_mm.as_dvec3()));
            }
        }
        let (low, high) = positions_mm.iter().fold(
            (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(low, high), position| (low.min(*position), high.max(*position)),
        );
        let middle_mm = 0.5 * (low + high);
        let farthest = positions_mm
            .iter()
            .map(|position| position.distance(middle_mm));
        Self {
            reach_mm: farthest.fold(0.0, f64::max),
            camera,
            body,
            positions_mm,
            middle_mm,
        }
    }

    /// What obstructs this light; `None` where all that the camera sees of the sample is
    /// free towards all of the lamp.
    pub fn obstruction(&self, light: &Light) -> Option<Obstruction> {
        if self.is_in_view(light) {
            return Some(Obstruction::LampInView);
        }
        if self.is_far_from(light) {
            return None;
        }
        let offsets = self.lamp_offsets(light);
        let (cut, lines) = self
            .cuts(light, &offsets)
            .fold((0usize, 0usize), |(cut, lines), is_cut| {
                (cut + usize::from(is_cut), lines + 1)
            });
        let part = cut as f64 / lines.max(1) as f64;
        (cut > 0).then_some(Obstruction::Shadow { part })
    }

    /// Whether anything obstructs this light: [`Self::obstruction`] without its part.
    pub fn blocks(&self, light: &Light) -> bool {
        let is_cut = || {
            self.cuts(light, &self.lamp_offsets(light))
                .any(|is_cut| is_cut)
        };
        self.is_in_view(light) || (!self.is_far_from(light) && is_cut())
    }

    /// For every line from a position to a point of the lamp, whether the body cuts it.
    fn cuts(&self, light: &Light, offsets: &[DVec2]) -> impl Iterator<Item = bool> {
        self.positions_mm.iter().flat_map(move |&position| {
            let (direction, distance_mm) = self.towards(light, position);
            let (x, y) = direction.any_orthonormal_pair();
            offsets.iter().map(move |offset| {
                let to_lamp = (direction + x * offset.x + y * offset.y).normalize();
                self.body.meets(position, to_lamp, distance_mm)
            })
        })
    }

    /// A lamp at a finite distance that hides a part of the image.
    fn is_in_view(&self, light: &Light) -> bool {
        let Light::Point { position_mm, .. } = *light else {
            return false;
        };
        let lamp = self.camera.sample_from_camera.inverse().point(position_mm);
        let depths = self.positions_mm.iter().map(|position| position.z);
        let lowest_mm = depths.fold(f64::NEG_INFINITY, f64::max);
        let [width, height] = self.camera.resolution_px.map(|side| side as f64);
        let is_inside = |at: DVec2| (0.0..width).contains(&at.x) && (0.0..height).contains(&at.y);
        (self.body.front_mm..lowest_mm).contains(&lamp.z)
            && self.camera.position_of_px(lamp).is_some_and(is_inside)
    }

    /// Whether the body is clear of every line from the positions to the lamp because a larger
    /// one is of the line from their middle.
    fn is_far_from(&self, light: &Light) -> bool {
        let CameraBody {
            radius_mm,
            length_mm,
            front_mm,
        } = self.body;
        let end_mm = self.middle_mm.length() + front_mm.abs() + length_mm + radius_mm;
        let wider_mm = self.reach_mm + angular_radius_rad(light).tan() * (end_mm + self.reach_mm);
        let wider = CameraBody {
            radius_mm: radius_mm + wider_mm,
            length_mm: length_mm + 2.0 * wider_mm,
            front_mm: front_mm + wider_mm,
        };
        let (direction, distance_mm) = self.towards(light, self.middle_mm);
        !wider.meets(self.middle_mm, direction, distance_mm)
    }

    /// Unit direction and distance of the lamp's middle from a position, camera frame.
    fn towards(&self, light: &Light, from_mm: DVec3) -> (DVec3, f64) {
        let to_camera = self.camera.sample_from_camera.inverse();
        match *light {
            Light::Directional { to_light, .. } => (to_camera.direction(to_light), f64::INFINITY),
            Light::Point { position_mm, .. } => {
                let offset = to_camera.point(position_mm) - from_mm;
                (offset.normalize(), offset.length())
            }
        }
    }

    /// Points of the lamp's disc, off the direction to its middle and across it, as tangents.
    fn lamp_offsets(&self, light: &Light) -> Vec<DVec2> {
        let radius_rad = angular_radius_rad(light);
        let rings = (radius_rad / RING_RAD).ceil() as usize;
        let mut offsets = vec![DVec2::ZERO];
        for ring in 1..=rings {
            let tangent = (radius_rad * ring as f64 / rings as f64).tan();
            offsets.extend(
                (0..RING_POINTS).map(|point| {
                    tangent * DVec2::from_angle(TAU * point as f64 / RING_POINTS as f64)
                }),
            );
        }
        offsets
    }
}

/// Half the angle under which the sample sees the lamp.
fn angular_radius_rad(light: &Light) -> f64 {
    match *light {
        Light::Directional {
            angular_radius_rad, ..
        } => angular_radius_rad,
        Light::Point { .. } => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::bvh::{Bvh, Ray};
    use crate::geometry::{Mesh, Shape};
    use crate::random::{Purpose, Stream, stream};
    use crate::transport::{Projection, Shading};

    const BODY: CameraBody = CameraBody {
        radius_mm: 20.0,
        length_mm: 150.0,
        front_mm: 5.0,
    };

    /// A closed prism with the cylinder's ends and this circumradius, in the camera's frame.
    fn prism(body: CameraBody, circumradius_mm: f64, sides: u32) -> Bvh {
        let mut positions = Vec::new();
        for z in [body.front_mm - body.length_mm, body.front_mm] {
            positions.push(DVec3::new(0.0, 0.0, z).as_vec3());
            positions.extend((0..sides).map(|side| {
                let turn = DVec2::from_angle(TAU * f64::from(side) / f64::from(sides));
                (circumradius_mm * turn).extend(z).as_vec3()
            }));
        }
        let mut triangles = Vec::new();
        for side in 0..sides {
            let [a, b] = [1 + side, 1 + (side + 1) % sides];
            let [c, d] = [a, b].map(|corner| corner + sides + 1);
            triangles.extend([[0, b, a], [sides + 1, c, d], [a, b, d], [a, d, c]]);
        }
        Bvh::new(&Mesh::new(positions, triangles).unwrap())
    }

    fn is_hit(mesh: &Bvh, from_mm: DVec3, direction: DVec3, distance_mm: f64) -> bool {
        mesh.any(&Ray {
            origin_mm: from_mm.as_vec3(),
            direction: direction.as_vec3(),
            limit_mm: distance_mm as f32,
        })
    }

    /// A camera 110 mm above a bowl of 10 mm radius; `tilt` moves it aside.
    fn scene(projection: Projection, tilt_mm: f64, lights: Vec<Light>) -> Scene {
        let bowl = Shape::Bowl {
            radius_mm: 10.0,
            segments: 32,
        };
        let position_mm = DVec3::new(tilt_mm, 0.5 * tilt_mm, 110.0);
        let camera =
            Camera::looking_at([64, 48], projection, position_mm, DVec3::ZERO, DVec3::Y).unwrap();
        Scene::new(bowl.mesh().unwrap(), Shading::Flat, camera, lights)
    }

    fn telecentric() -> Projection {
        Projection::Orthographic {
            extent_mm: DVec2::new(29.3, 22.0),
        }
    }

    fn far(elevation_deg: f64, angular_radius_deg: f64) -> Light {
        let (sin, cos) = elevation_deg.to_radians().sin_cos();
        Light::Directional {
            to_light: DVec3::new(cos, 0.0, sin),
            irradiance: [1.0; 3],
            angular_radius_rad: angular_radius_deg.to_radians(),
        }
    }

    fn near(position_mm: DVec3) -> Light {
        Light::Point {
            position_mm,
            intensity_mm2: [1.0; 3],
        }
    }

    proptest! {
        /// A line that meets the prism inside the cylinder meets the cylinder, and one that
        /// meets the cylinder meets the prism around it: to 0.1% of the radius.
        #[test]
        fn the_cylinder_is_where_rays_meet_a_mesh_of_it(
            seed in 0u64..1 << 32,
            radius_mm in 3.0..60.0,
            length_mm in 5.0..300.0,
            front_mm in -20.0..50.0,
        ) {
            let body = CameraBody { radius_mm, length_mm, front_mm };
            let half_side = std::f64::consts::PI / 64.0;
            let inner = prism(body, 0.9999 * radius_mm, 64);
            let outer = prism(body, 1.0001 * radius_mm / half_side.cos(), 64);
            let mut numbers = stream(seed, Purpose::Experiment, 0, 0, 0);
            let within = |numbers: &mut Stream, size: f64| size * (2.0 * numbers.uniform() - 1.0);
            for _ in 0..200 {
                let x = within(&mut numbers, 2.0 * radius_mm);
                let y = within(&mut numbers, 2.0 * radius_mm);
                let z = front_mm + 1.0 + 200.0 * numbers.uniform();
                let from = DVec3::new(x, y, z);
                // Half of them towards the body, the others anywhere.
                let aim = DVec3::new(
                    within(&mut numbers, 1.3 * radius_mm),
                    within(&mut numbers, 1.3 * radius_mm),
                    front_mm - length_mm * numbers.uniform(),
                );
                let anywhere = DVec3::new(
                    within(&mut numbers, 1.0), within(&mut numbers, 1.0), within(&mut numbers, 1.0),
                );
                let offset = if numbers.uniform() < 0.5 { aim - from } else { anywhere * 500.0 };
                let distance_mm = offset.length() * (0.5 + numbers.uniform());
                let direction = offset.normalize();
                let meets = body.meets(from, direction, distance_mm);
                if is_hit(&inner, from, direction, 0.9999 * distance_mm) {
                    prop_assert!(meets, "{from} {direction}");
                }
                if meets {
                    prop_assert!(is_hit(&outer, from, direction, 1.0001 * distance_mm), "{from} {direction}");
                }
            }
        }
    }

    /// The shadow of lamps near and far, wide and small, against rays cast from other positions
    /// than the ones it looks at, at a mesh of the body, towards random points of the lamp.
    #[test]
    fn the_shadow_is_that_of_rays_cast_at_a_mesh() {
        let perspective = Projection::Perspective { fov_rad: 0.25 };
        for (case, (projection, tilt_mm)) in [
            (telecentric(), 0.0),
            (telecentric(), 60.0),
            (perspective, 30.0),
        ]
        .into_iter()
        .enumerate()
        {
            let scene = scene(projection, tilt_mm, Vec::new());
            let shadow = CameraShadow::new(&scene, BODY);
            let mesh = prism(BODY, BODY.radius_mm, 256);
            let to_camera = scene.camera.sample_from_camera.inverse();
            let mut numbers = stream(11, Purpose::Experiment, case as u64, 0, 0);
            let [mut free, mut cut] = [0, 0];
            for number in 0..400 {
                // Around the camera, where it matters.
                let away = DVec3::new(numbers.normal(), numbers.normal(), 0.0) * 0.25;
                let axis = scene.camera.sample_from_camera.direction(-DVec3::Z);
                let to_light = (axis + away).normalize();
                let angular_radius_rad = [0.0, 0.02, 0.1][number % 3];
                let light = match number % 2 {
                    0 => near(to_light * 300.0),
                    _ => Light::Directional {
                        to_light,
                        irradiance: [1.0; 3],
                        angular_radius_rad,
                    },
                };
                let mut hits = 0;
                let mut rays = 0;
                while rays < 1500 {
                    let at = DVec2::new(64.0 * numbers.uniform(), 48.0 * numbers.uniform());
                    let hit = scene.first(&scene.camera.ray(at, DVec2::ZERO));
                    let Some((surface, _)) = hit else { continue };
                    let u = [numbers.uniform_f32(), numbers.uniform_f32()];
                    let sample = light.sample(surface.origin_mm, u);
                    let from = to_camera.point(surface.origin_mm.as_dvec3());
                    let direction = to_camera.direction(sample.direction.as_dvec3());
                    hits += usize::from(is_hit(&mesh, from, direction, sample.distance_mm.into()));
                    rays += 1;
                }
                let cast = hits as f64 / rays as f64;
                assert_eq!(shadow.blocks(&light), shadow.obstruction(&light).is_some());
                match shadow.obstruction(&light) {
                    Some(Obstruction::Shadow { part }) => {
                        cut += 1;
                        // The ring is denser in the middle of a lamp than random points are.
                        let tolerance = if angular_radius_rad > 0.0 { 0.12 } else { 0.05 };
                        assert!(
                            (part - cast).abs() < tolerance,
                            "{light:?}: {part}, cast {cast}"
                        );
                    }
                    other => {
                        free += 1;
                        assert_eq!(other, None);
                        assert!(cast < 2e-3, "{light:?}: free, cast {cast}");
                    }
                }
            }
            assert!(free > 40 && cut > 40, "{free} free, {cut} cut");
        }
    }

    /// A body of 20 mm radius whose front is 105 mm above the rim: what is seen of the bowl
    /// reaches 10 mm to each side, so a far lamp is free where the lower edge of the front is
    /// below every line: tan(polar) > (20 + 10)/105 for the rim, (20 + ρ)/(105 + depth) inside.
    #[test]
    fn the_free_elevation_is_that_of_a_drawing() {
        let shadow = CameraShadow::new(&scene(telecentric(), 0.0, Vec::new()), BODY);
        let limit_deg = 90.0 - (30.0f64 / 105.0).atan().to_degrees();
        assert!(shadow.obstruction(&far(limit_deg - 0.5, 0.0)).is_none());
        assert!(shadow.obstruction(&far(limit_deg + 0.5, 0.0)).is_some());
        // A lamp of 3° radius reaches 3° further up.
        assert!(shadow.obstruction(&far(limit_deg - 2.5, 3.0)).is_some());
        assert!(shadow.obstruction(&far(limit_deg - 3.5, 3.0)).is_none());
        // Far from the body, and from below.
        assert!(shadow.obstruction(&far(10.0, 3.0)).is_none());
    }

    /// A lamp in front of the lens shades nothing and hides the sample; next to the view, or
    /// behind the lens, it does not.
    #[test]
    fn a_lamp_in_the_view_is_caught_too() {
        let shadow = CameraShadow::new(&scene(telecentric(), 0.0, Vec::new()), BODY);
        let at = |x_mm: f64, z_mm: f64| shadow.obstruction(&near(DVec3::new(x_mm, 0.0, z_mm)));
        assert_eq!(at(0.0, 60.0), Some(Obstruction::LampInView));
        assert_eq!(at(12.0, 60.0), Some(Obstruction::LampInView));
        assert_eq!(at(16.0, 60.0), None);
        assert!(matches!(at(0.0, 400.0), Some(Obstruction::Shadow { part }) if part > 0.99));
        assert_eq!(at(380.0, 130.0), None);
    }
}
