//! Whether a scene can be measured at all: how much of the sample the camera sees, which
//! side of it, and which lights reach what is seen. A pure statement about mesh, camera
//! and lights, cheap enough to be made before anything moves or is rendered.

use glam::{DVec2, DVec3};

use super::camera::{Camera, Projection};
use super::scene::Scene;
use crate::shown::nth;

/// Sides of the grid of rays through the image, and points spread over the surface.
const GRID: usize = 96;
const POINTS: usize = 4096;

/// Least part of the sample that must lie in the image. Below it, only where the sample
/// fills [`FILLED`] of the image is it a large sample seen closely, and ...
const LEAST_IN_VIEW: f64 = 0.1;
const FILLED: f64 = 0.5;
/// ... below this part its size is not that of anything in front of this camera: the image
/// would be thirty times smaller than the sample.
const LEAST_OF_LARGE: f64 = 1e-3;
/// Part in view below which the rest is worth a remark: a rim that the uncertainty of the
/// pose cuts off is not.
const WHOLE: f64 = 0.95;
/// Fewest pixels, and least part of the image, that a fit can learn from. A mesh in metres
/// that is read as millimetres covers a millionth of what it should.
const LEAST_PX: f64 = 16.0;
const LEAST_OF_IMAGE: f64 = 1e-5;
/// Least part of what is seen that must be the front. A hollow sample seen from below or
/// inside out shows none; one seen obliquely may show a third of its outer back.
const LEAST_FRONT: f64 = 0.1;
/// Part of the front below which the backs, which are black, are worth a remark.
const MOSTLY_FRONT: f64 = 0.9;
/// Least part of the visible front that a light must reach: less is an image of noise.
const LEAST_LIT: f64 = 1e-3;

/// What camera and lights see of the sample. Parts are of projected area, 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Visibility {
    /// Least and largest coordinates of the sample, sample frame, millimetres.
    pub bounds_mm: [DVec3; 2],
    /// Top left and bottom right corner of the box around the sample's projection, pixels
    /// from the top left corner of the image; may lie outside it. `None` where a part of the
    /// sample is behind the camera.
    pub projected_px: Option<[DVec2; 2]>,
    /// Width and height of the image, pixels.
    pub resolution_px: [usize; 2],
    /// Width and height of what the image shows at the depth of the sample's middle,
    /// millimetres; zero where that is behind the camera.
    pub field_mm: DVec2,
    /// Part of the sample, as it appears from the camera's position, that is within the image.
    pub in_view: f64,
    /// Pixels of the image that show the sample, from whichever side.
    pub covered_px: f64,
    /// Part of these that show its front, where the reflectance is; backs are black.
    pub front: f64,
    /// By light.
    pub lights: Vec<LightReach>,
}

/// What one light reaches of the front that the camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightReach {
    /// Part that it shines on.
    pub lit: f64,
    /// Part that is turned towards it but lies in shadow.
    pub shadowed: f64,
    /// Part that is turned away from it: the light is at or below its horizon.
    pub turned_away: f64,
}

/// What makes a scene unfit to be measured, or is worth a remark.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Concern {
    /// (Nearly) nothing of the sample is within the image.
    #[error("the sample is outside the camera's view: {:.1}% of it is in the image", 100.0 * .in_view)]
    OutOfView {
        /// Part within the image.
        in_view: f64,
    },
    /// A part of the sample is cut off by the image's edge.
    #[error("the sample is only partly in view: {:.0}% of it is in the image", 100.0 * .in_view)]
    PartlyInView {
        /// Part within the image.
        in_view: f64,
    },
    /// The sample covers next to nothing of the image.
    #[error(
        "the sample is too small in the image: it covers {covered_px:.1} pixels, and at least {least_px:.0} are needed"
    )]
    TooSmall {
        /// Pixels that show it.
        covered_px: f64,
        /// Fewest that are of use.
        least_px: f64,
    },
    /// The camera sees the sample's back: it is upside down, or its mesh is inside out.
    #[error("the sample's surface faces away from the camera: {:.1}% of what the camera sees is its front, the rest are backs of facets", 100.0 * .front)]
    FacesAway {
        /// Part of the front.
        front: f64,
    },
    /// A part of what the camera sees is the sample's back.
    #[error("a part of the sample's surface faces away from the camera: {:.0}% of what the camera sees is its front", 100.0 * .front)]
    PartlyFacesAway {
        /// Part of the front.
        front: f64,
    },
    /// A light reaches nothing that the camera sees.
    #[error(
        "{light} reaches {:.1}% of what the camera sees of the sample: {:.0}% is turned away from it, {:.0}% lies in shadow",
        100.0 * .reach.lit, 100.0 * .reach.turned_away, 100.0 * .reach.shadowed, light = nth("light", *light)
    )]
    Unlit {
        /// The light, from 0.
        light: usize,
        /// What it reaches.
        reach: LightReach,
    },
}

impl Concern {
    /// Whether nothing can come of a measurement, as against a remark.
    pub fn is_fatal(&self) -> bool {
        !matches!(
            self,
            Self::PartlyInView { .. } | Self::PartlyFacesAway { .. }
        )
    }
}

impl Visibility {
    /// Looks at the sample through a grid of rays of the scene's camera, and at the camera
    /// and the lights from there.
    pub fn of(scene: &Scene) -> Self {
        let camera = &scene.camera;
        let [width, height] = camera.resolution_px.map(|n| n as f64);
        let [low, high] = scene.sample().bounds_mm().map(|corner| corner.as_dvec3());
        let projection = Projected::of(scene);
        let (corner, size) = match projection.bounds_px {
            Some([low, high]) if projection.is_within_image => (low, high - low),
            _ => (DVec2::ZERO, DVec2::new(width, height)),
        };
        let mut seen = Seen::new(scene.lights.len());
        for position in 0..GRID * GRID {
            let at = DVec2::new(
                (position % GRID) as f64 + 0.5,
                (position / GRID) as f64 + 0.5,
            );
            seen.look(scene, corner + size * at / GRID as f64);
        }
        Self {
            bounds_mm: [low, high],
            projected_px: projection.bounds_px,
            resolution_px: camera.resolution_px,
            field_mm: camera.field_mm(0.5 * (low + high)),
            in_view: in_view(scene),
            covered_px: size.x * size.y * seen.sample as f64 / (GRID * GRID) as f64,
            front: part(seen.front, seen.sample),
            lights: seen.reaches(),
        }
    }

    /// Concerns about the scene, the fatal ones first.
    pub fn concerns(&self) -> Vec<Concern> {
        let image_px = self.resolution_px.iter().product::<usize>() as f64;
        let filled = self.covered_px / image_px;
        let (in_view, covered_px, front) = (self.in_view, self.covered_px, self.front);
        let least_px = LEAST_PX.max(LEAST_OF_IMAGE * image_px);
        let is_seen_closely = in_view >= LEAST_OF_LARGE && filled >= FILLED;
        if in_view < LEAST_IN_VIEW && !is_seen_closely {
            return vec![Concern::OutOfView { in_view }];
        }
        if covered_px < least_px {
            return vec![Concern::TooSmall {
                covered_px,
                least_px,
            }];
        }
        if front < LEAST_FRONT {
            return vec![Concern::FacesAway { front }];
        }
        let unlit = self
            .lights
            .iter()
            .enumerate()
            .filter_map(|(light, &reach)| {
                (reach.lit < LEAST_LIT).then_some(Concern::Unlit { light, reach })
            });
        let cut = (in_view < WHOLE).then_some(Concern::PartlyInView { in_view });
        let back = (front < MOSTLY_FRONT).then_some(Concern::PartlyFacesAway { front });
        unlit.chain(cut).chain(back).collect()
    }

    /// How many times the sample is longer than the field of view is wide or high.
    pub fn times_the_field(&self) -> f64 {
        let size_mm = self.bounds_mm[1] - self.bounds_mm[0];
        size_mm.max_element() / self.field_mm.max_element()
    }
}

/// What the grid of rays meets.
struct Seen {
    sample: usize,
    front: usize,
    lit: Vec<usize>,
    shadowed: Vec<usize>,
}

impl Seen {
    fn new(lights: usize) -> Self {
        Self {
            sample: 0,
            front: 0,
            lit: vec![0; lights],
            shadowed: vec![0; lights],
        }
    }

    fn look(&mut self, scene: &Scene, at_px: DVec2) {
        let ray = scene.camera.ray(at_px, DVec2::ZERO);
        let Some((surface, is_front)) = scene.meet(&ray).filter(|(s, _)| s.is_sample()) else {
            return;
        };
        self.sample += 1;
        if !is_front {
            return;
        }
        self.front += 1;
        for light in 0..scene.lights.len() {
            // The middle of an extended lamp.
            let to_light = scene.lights[light].sample(surface.origin_mm, [0.0; 2]);
            if scene.connect(&surface, light, [0.0; 2]).is_some() {
                self.lit[light] += 1;
            } else if surface.leaves(to_light.direction)
                && surface.local(to_light.direction).z > 0.0
            {
                self.shadowed[light] += 1;
            }
        }
    }

    fn reaches(&self) -> Vec<LightReach> {
        let counts = self.lit.iter().zip(&self.shadowed);
        counts
            .map(|(&lit, &shadowed)| LightReach {
                lit: part(lit, self.front),
                shadowed: part(shadowed, self.front),
                turned_away: part(self.front - lit - shadowed, self.front),
            })
            .collect()
    }
}

/// 0 of nothing.
fn part(some: usize, all: usize) -> f64 {
    some as f64 / all.max(1) as f64
}

/// Where the sample's corners appear.
struct Projected {
    bounds_px: Option<[DVec2; 2]>,
    is_within_image: bool,
}

impl Projected {
    fn of(scene: &Scene) -> Self {
        let camera = &scene.camera;
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let (mut is_before, mut is_within_image) = (true, true);
        for &corner in &scene.sample().positions_mm {
            let corner = corner.as_dvec3();
            is_within_image &= shows(camera, corner);
            let corner = camera.sample_from_camera.inverse().point(corner);
            match camera.position_of_px(corner).filter(|_| corner.z > 0.0) {
                Some(at) => (low, high) = (low.min(at), high.max(at)),
                None => is_before = false,
            }
        }
        Self {
            bounds_px: is_before.then_some([low, high]),
            is_within_image,
        }
    }
}

/// Whether a point is before the camera and within its image. A lens maps points far outside
/// its image anywhere, so the ray must lead back to the point.
fn shows(camera: &Camera, point_mm: DVec3) -> bool {
    let point = camera.sample_from_camera.inverse().point(point_mm);
    let Some(at) = camera.position_of_px(point).filter(|_| point.z > 0.0) else {
        return false;
    };
    let [width, height] = camera.resolution_px.map(|n| n as f64);
    if !((0.0..=width).contains(&at.x) && (0.0..=height).contains(&at.y)) {
        return false;
    }
    let (origin, direction) = camera.chief_ray(at);
    let off = (point - origin).reject_from_normalized(direction);
    off.length() <= 1e-3 * point.length()
}

/// Part of the sample that appears within the image, of what would appear in an image
/// without edges: points spread evenly over the surface, weighted by how they are turned.
fn in_view(scene: &Scene) -> f64 {
    let camera = &scene.camera;
    let mesh = scene.sample();
    let pose = &camera.sample_from_camera;
    let ahead = pose.direction(DVec3::Z);
    let area = |triangle: usize| {
        let [a, b, c] = mesh.corners(triangle).map(|corner| corner.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    };
    let whole: f64 = (0..mesh.triangles.len()).map(area).sum();
    let (mut within, mut all) = (0.0, 0.0);
    let (mut covered, mut point) = (0.0, 0);
    for triangle in 0..mesh.triangles.len() {
        covered += area(triangle);
        while (point as f64 + 0.5) * whole < covered * POINTS as f64 && point < POINTS {
            let surface = scene.surface(triangle as u32, evenly(point));
            point += 1;
            let position = surface.origin_mm.as_dvec3();
            let (to_camera, distance_mm) = match camera.projection {
                Projection::Orthographic { .. } => (-ahead, f32::INFINITY),
                Projection::Perspective { .. } => {
                    let away = pose.translation_mm - position;
                    (away.normalize_or_zero(), away.length() as f32)
                }
            };
            let cosine = f64::from(mesh.face_normal(triangle).dot(to_camera.as_vec3()));
            let is_ahead = (position - pose.translation_mm).dot(ahead) > 0.0;
            if is_ahead && scene.is_blocked(&surface, to_camera.as_vec3(), distance_mm) {
                continue;
            }
            all += cosine.abs();
            if shows(camera, position) {
                within += cosine.abs();
            }
        }
    }
    if all > 0.0 { within / all } else { 0.0 }
}

/// Barycentric coordinates, spread evenly over a triangle by the additive recurrence of
/// Roberts' R2 sequence.
fn evenly(point: usize) -> [f32; 2] {
    let along = |step: f64| (0.5 + step * point as f64).fract() as f32;
    let [u, v] = [
        along(0.754_877_666_246_692_7),
        along(0.569_840_290_998_053_3),
    ];
    if u + v > 1.0 {
        [1.0 - u, 1.0 - v]
    } else {
        [u, v]
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::frames::Rigid;
    use crate::geometry::{Mesh, Shape};
    use crate::transport::{Body, Light, Shading};

    const UPSIDE_DOWN: DVec3 = DVec3::new(std::f64::consts::PI, 0.0, 0.0);

    fn bowl(radius_mm: f32) -> Mesh {
        let segments = 64;
        let shape = Shape::Bowl {
            radius_mm,
            segments,
        };
        shape.mesh().unwrap()
    }

    fn inside_out(mut mesh: Mesh) -> Mesh {
        for [_, b, c] in &mut mesh.triangles {
            std::mem::swap(b, c);
        }
        mesh
    }

    fn moved(mesh: &Mesh, rotation_rad: DVec3, by_mm: DVec3) -> Mesh {
        mesh.transformed::<(), ()>(&Rigid::from_rotation_vector(rotation_rad, by_mm))
    }

    /// 64 × 64 pixels of a field 22 mm wide at the origin, 200 mm above it.
    fn camera(perspective: bool, up_from: DVec3) -> Camera {
        let projection = match perspective {
            true => Projection::Perspective {
                fov_rad: 2.0 * (11.0f64 / 200.0).atan(),
            },
            false => Projection::Orthographic {
                extent_mm: DVec2::splat(22.0),
            },
        };
        Camera::looking_at([64, 64], projection, up_from, DVec3::ZERO, DVec3::Y).unwrap()
    }

    fn sun(x: f64, z: f64) -> Light {
        Light::distant(DVec3::new(x, 0.0, z), [1.0; 3])
    }

    fn concerns(mesh: Mesh, camera: Camera, lights: Vec<Light>) -> Vec<Concern> {
        let scene = Scene::new(mesh, Shading::Flat, camera, lights);
        Visibility::of(&scene).concerns()
    }

    /// By hand: a disk of radius 10 in a field of 22 mm, all of it front. A lamp 45° off the
    /// axis shines into a hemisphere on the half of the opening beyond where its rim's
    /// shadow ends.
    #[test]
    fn a_bowl_in_view_is_measured() {
        for perspective in [false, true] {
            let camera = camera(perspective, 200.0 * DVec3::Z);
            let lights = vec![sun(0.0, 1.0), sun(1.0, 1.0)];
            let scene = Scene::new(bowl(10.0), Shading::Flat, camera, lights);
            let seen = Visibility::of(&scene);
            assert_eq!(seen.concerns(), [], "{seen:?}");
            assert_eq!(seen.in_view, 1.0);
            assert_eq!(seen.front, 1.0);
            let disk_px = std::f64::consts::PI * (10.0f64 / 22.0 * 64.0).powi(2);
            assert!((seen.covered_px / disk_px - 1.0).abs() < 0.02, "{seen:?}");
            let [low, high] = seen.projected_px.unwrap();
            assert!((low - 2.9).abs().max_element() < 0.05, "{seen:?}");
            assert!((high - 61.1).abs().max_element() < 0.05, "{seen:?}");
            assert!((seen.field_mm - 22.0).abs().max_element() < 0.6, "{seen:?}");
            let [above, aslant] = seen.lights[..] else {
                panic!("{seen:?}")
            };
            assert!(above.lit > 0.99, "{above:?}");
            assert!((0.4..0.6).contains(&aslant.lit), "{aslant:?}");
            let sum = aslant.lit + aslant.shadowed + aslant.turned_away;
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }

    /// What is found first, and whether it is fatal, in scenes that make no sense.
    #[test]
    fn nonsense_is_named() {
        let above = 200.0 * DVec3::Z;
        let good = || vec![sun(0.0, 1.0)];
        let aside = |x: f64| moved(&bowl(10.0), DVec3::ZERO, DVec3::new(x, 0.0, 0.0));
        let far = |z: f64| moved(&bowl(10.0), DVec3::ZERO, DVec3::new(0.0, 0.0, z));
        let over = |by: DVec3| moved(&bowl(10.0), by, DVec3::ZERO);
        let closed = Shape::Sphere {
            radius_mm: 8.0,
            segments: 64,
        };
        let closed = closed.mesh().unwrap();
        type Expected = fn(&Concern) -> bool;
        let out: Expected = |c| matches!(c, Concern::OutOfView { .. });
        let cut: Expected =
            |c| matches!(c, Concern::PartlyInView { in_view } if (0.1..0.95).contains(in_view));
        let small: Expected = |c| matches!(c, Concern::TooSmall { .. });
        let back: Expected = |c| matches!(c, Concern::FacesAway { .. });
        let unlit: Expected = |c| matches!(c, Concern::Unlit { light: 0, .. });
        let cases: Vec<(&str, Mesh, bool, Vec<Light>, Expected)> = vec![
            ("beside the field", aside(40.0), false, good(), out),
            ("beside the field, pinhole", aside(40.0), true, good(), out),
            ("a sliver in view", aside(20.5), false, good(), out),
            ("behind the camera", far(300.0), false, good(), out),
            ("behind the pinhole", far(300.0), true, good(), out),
            ("micrometres", bowl(10_000.0), false, good(), out),
            ("metres", bowl(0.01), false, good(), small),
            ("metres, pinhole", bowl(0.01), true, good(), small),
            ("upside down", over(UPSIDE_DOWN), false, good(), back),
            (
                "upside down, pinhole",
                over(UPSIDE_DOWN),
                true,
                good(),
                back,
            ),
            ("inside out", inside_out(bowl(10.0)), false, good(), back),
            (
                "closed, inside out",
                inside_out(closed),
                false,
                good(),
                back,
            ),
            (
                "lit from below",
                bowl(10.0),
                false,
                vec![sun(0.3, -1.0)],
                unlit,
            ),
            (
                "lit along the rim",
                bowl(10.0),
                false,
                vec![sun(1.0, 0.0)],
                unlit,
            ),
            ("half in view", aside(11.0), false, good(), cut),
        ];
        for (name, mesh, perspective, lights, expected) in cases {
            let camera = camera(perspective, above);
            let found = concerns(mesh, camera, lights);
            let first = found.first().unwrap_or_else(|| panic!("{name}: nothing"));
            assert!(expected(first), "{name}: {found:?}");
            let is_remark = name == "half in view";
            assert_eq!(first.is_fatal(), !is_remark, "{name}: {first}");
        }
    }

    /// What real benches do is no nonsense: a plate that fills the field and more, a bowl seen
    /// obliquely with the outside of its wall, one unlit light of two, a lens that distorts.
    #[test]
    fn unusual_scenes_are_not_refused() {
        let above = 200.0 * DVec3::Z;
        let good = || vec![sun(0.0, 1.0)];
        let plate = bowl(100.0);
        let found = concerns(plate, camera(false, above), good());
        assert!(matches!(found[..], [Concern::PartlyInView { in_view }] if in_view < 0.05));
        let oblique = camera(false, 200.0 * DVec3::new(0.9, 0.0, 0.436));
        let found = concerns(bowl(7.0), oblique, good());
        let [Concern::PartlyFacesAway { front }] = found[..] else {
            panic!("{found:?}")
        };
        // The opening over the silhouette: 2 cos θ / (1 + cos θ).
        assert!((front - 2.0 * 0.436 / 1.436).abs() < 0.02, "{front}");
        let two = vec![sun(0.0, 1.0), sun(0.0, -1.0)];
        let found = concerns(bowl(10.0), camera(false, above), two);
        assert!(
            matches!(found[..], [Concern::Unlit { light: 1, reach }] if reach.turned_away == 1.0)
        );
    }

    #[test]
    fn a_holder_may_hide_the_sample_or_its_lamp() {
        let camera = camera(false, 200.0 * DVec3::Z);
        let grey = Dictionary::new("grey", vec![Atom::Lambertian { albedo: 0.5 }]).unwrap();
        let cover = Body {
            mesh: moved(&bowl(12.0), UPSIDE_DOWN, DVec3::new(0.0, 0.0, 20.0)),
            shading: Shading::Flat,
            brdf: Arc::new(
                Mixture::new(Arc::new(grey), std::array::from_fn(|_| vec![1.0])).unwrap(),
            ),
        };
        let mesh = bowl(10.0);
        let lights = vec![sun(0.0, 1.0)];
        let scene = Scene::with_bodies(mesh, Shading::Flat, vec![cover], camera, lights);
        let seen = Visibility::of(&scene);
        assert!(seen.concerns()[0].is_fatal(), "{seen:?}");
    }
}
