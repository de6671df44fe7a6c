//! Images and scenes that cannot be what they are said to be: refused before the work, or a
//! fit whose verdict is that it is not to be trusted, with the reason. And sound ones, which
//! must not be.

use std::path::Path;

use crate::command_support::{cases, run_line as rig};
use rig::radiance_image::{RadianceImage, exr};

/// A bowl under two lights, of a material that no dictionary holds exactly.
const SCENE: &str = r#"
[camera]
model = "orthographic"
resolution_px = [24, 24]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]

[[light]]
kind = "directional"
to_light = [0.1, 0.05, 0.99]
irradiance = 3.14

[[light]]
kind = "directional"
to_light = [0.5, 0.2, 0.85]
irradiance = 3.14

[sample]
shape = { kind = "bowl", radius_mm = 1.0, segments = 96 }
shading = "smooth"

[brdf]
mixture = [
  { weight = [0.5, 0.4, 0.45], lambertian = { albedo = 1.0 } },
  { weight = 0.2, ggx = { alpha = 0.25, eta = 1.6 } },
  { weight = [0.3, 0.4, 0.35], black = {} },
]
"#;

/// How a fit ended: its verdict, or that it was refused, and what was said.
fn outcome(folder: &Path, scene: &str, images: &[RadianceImage]) -> (String, String) {
    std::fs::write(folder.join("s.toml"), scene).unwrap();
    for (light, image) in images.iter().enumerate() {
        let path = folder.join(format!("{light}.exr"));
        std::fs::write(&path, exr::encode(image, &path).unwrap()).unwrap();
    }
    drop(std::fs::remove_dir_all(folder.join("fit")));
    let names: Vec<String> = (0..images.len()).map(|l| format!("{l}.exr")).collect();
    let done = rig(
        folder,
        &format!(
            "fit --scene s.toml --image {} --spp 128 --kernel portable --json --out fit",
            names.join(" ")
        ),
    );
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    match done.status.code() {
        Some(0) => {
            let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
            let stated = std::fs::read_to_string(folder.join("fit/fit.toml")).unwrap();
            let verdict = json["verdict"].as_str().unwrap().to_owned();
            assert!(
                stated.contains(&format!("verdict = \"{verdict}\"")),
                "{stated}"
            );
            (verdict, said)
        }
        Some(1) => {
            assert!(said.contains("hint: "), "{said}");
            assert!(!folder.join("fit").exists(), "refused, yet written: {said}");
            ("refused".to_owned(), said)
        }
        _ => panic!("{:?}: {said}", done.status),
    }
}

/// Applies `change` to a pixel's values and variances, given its index.
fn each(
    images: &[RadianceImage],
    change: impl Fn(usize, &mut [f32; 3], &mut [f32; 3]),
) -> Vec<RadianceImage> {
    let mut images = images.to_vec();
    for image in &mut images {
        let both = image.mean.iter_mut().zip(&mut image.variance);
        for (pixel, (mean, variance)) in both.enumerate() {
            change(pixel, mean, variance);
        }
    }
    images
}

fn scaled(images: &[RadianceImage], factor: f32) -> Vec<RadianceImage> {
    each(images, |_, mean, variance| {
        *mean = mean.map(|v| factor * v);
        *variance = variance.map(|v| factor * factor * v);
    })
}

fn flipped(image: &RadianceImage) -> RadianceImage {
    let mut flipped = image.clone();
    for y in 0..image.height {
        let row = y * image.width..(y + 1) * image.width;
        flipped.mean[row.clone()].reverse();
        flipped.variance[row.clone()].reverse();
        flipped.valid[row].reverse();
    }
    flipped
}

/// Even noise in 0..1 by pixel and channel.
fn noise(pixel: usize, channel: usize) -> f32 {
    let mut bits = (3 * pixel + channel) as u64 + 1;
    bits = (bits ^ (bits >> 31)).wrapping_mul(0x7fb5_d329_728e_a185);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x81da_def4_bc2d_d44d);
    ((bits ^ (bits >> 33)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Scene, images and a word that the reason must hold.
type Nonsense = (&'static str, String, Vec<RadianceImage>, &'static str);

fn nonsense(good: &[RadianceImage]) -> Vec<Nonsense> {
    let constant = |value: f32, variance: f32| {
        each(good, |_, m, v| {
            (*m, *v) = ([value; 3], [variance; 3]);
        })
    };
    let noisy = |level: f32, variance: f32| {
        let mut lights = 0;
        let images = good.iter().map(|image| {
            lights += 100_000;
            let shift = lights;
            each(std::slice::from_ref(image), |p, m, v| {
                *m = std::array::from_fn(|c| level * noise(p + shift, c));
                *v = [variance; 3];
            })
            .remove(0)
        });
        images.collect::<Vec<_>>()
    };
    let lit = |pixels: std::ops::Range<usize>, background: f32| {
        each(good, |p, m, v| {
            let value = if pixels.contains(&p) { 1.0 } else { background };
            (*m, *v) = ([value; 3], [1e-6; 3]);
        })
    };
    let (one, four) = (300..301, 300..304);
    let with_variance = |variance: f32| each(good, |_, _, v| *v = [variance; 3]);
    let times_variance = |factor: f32| each(good, |_, _, v| *v = v.map(|v| factor * v));
    let second_as_first = vec![good[0].clone(), good[0].clone()];
    let exchanged = vec![good[1].clone(), good[0].clone()];
    let mirrored = good.iter().map(flipped).collect();
    let channel = |factor: f32| {
        each(good, |_, m, v| {
            m[0] *= factor;
            v[0] *= factor * factor;
        })
    };
    let warm_noise = each(&noisy(1e-3, 1e-7), |_, m, _| *m = m.map(|v| v + 0.3));
    let negative = each(good, |_, m, _| *m = m.map(|v| -v));
    let half_negative = each(good, |p, m, _| {
        if p % 24 < 12 {
            *m = m.map(|v| -v)
        }
    });
    let of_images = [
        ("black", constant(0.0, 0.0), "shows no light"),
        ("black with noise", constant(0.0, 1e-6), "shows no light"),
        ("nearly black", constant(1e-8, 1e-22), "shows no light"),
        (
            "constant",
            constant(0.3, 1e-6),
            "same radiance in every pixel",
        ),
        ("constant with noise", warm_noise, ""),
        ("noise", noisy(0.6, 0.03), ""),
        ("noise said to be exact", noisy(0.6, 1e-6), ""),
        ("one lit pixel", lit(one.clone(), 0.0), "in one pixel"),
        ("one lit pixel, dim", lit(one.clone(), 1e-5), "in one pixel"),
        ("four lit pixels", lit(four, 0.0), ""),
        ("negative", negative, "negative"),
        ("half negative", half_negative, "negative"),
        (
            "one channel 10 times too bright",
            channel(10.0),
            "red channel",
        ),
        ("variance 0", with_variance(0.0), "variance"),
        ("huge variance", with_variance(1e6), "shows no light"),
        (
            "variance 400 times too large",
            times_variance(400.0),
            "scatter",
        ),
        ("images exchanged", exchanged, "looks like that of light"),
        ("images mirrored", mirrored, "looks like that of light"),
        ("one image twice", second_as_first, "equal in every pixel"),
    ];
    let of_images =
        of_images.map(|(what, images, reason)| (what, SCENE.to_owned(), images, reason));
    let of_brightness = cases(
        "
        a third as bright | 0.33 | times the stated one
        a fifth as bright | 0.2 | times the stated one
        3 times too bright | 3.0 | times the stated one
        10 times too bright | 10.0 | times as bright
        30 times too bright | 30.0 | times as bright
        1000 times too bright | 1000.0 | times as bright
        unphysically bright | 1e15 | times as bright
        beyond all numbers | 1e30 | enough valid pixels
    ",
    );
    let of_brightness = of_brightness.map(|[what, factor, reason]| {
        let images = scaled(good, factor.parse().unwrap());
        (what, SCENE.to_owned(), images, reason)
    });
    // What the scene has, and what stands there instead.
    let of_scenes = cases(
        r"
        light behind | [0.1, 0.05, 0.99] | [0.1, 0.05, -0.99] | reaches 0.0% of what the camera sees
        light at the horizon | [0.5, 0.2, 0.85] | [1.0, 0.0, 0.0] | light 2 reaches 0.0%
        no irradiance | irradiance = 3.14 | irradiance = 0.0 | irradiance of light 1
        no blue irradiance | irradiance = 3.14 | irradiance = [3.14, 3.14, 0.0] | blue irradiance
        sample out of view | [0.0, 0.0, 5.0] | [9.0, 0.0, 5.0]; look_at_mm = [9.0, 0.0, 0.0] | outside the camera's view
        seen from behind | [0.0, 0.0, 5.0] | [0.0, 0.0, -5.0] | faces away from the camera
        sample in metres | radius_mm = 1.0 | radius_mm = 0.001 | metres
    ",
    );
    let of_scenes = of_scenes.map(|[what, from, to, reason]| {
        assert!(SCENE.contains(from), "{from}");
        let scene = SCENE.replace(from, &to.replace("; ", "\n"));
        (what, scene, good.to_vec(), reason)
    });
    of_images
        .into_iter()
        .chain(of_brightness)
        .chain(of_scenes)
        .collect()
}

/// None is praised, and the reason is named.
#[test]
fn nonsense_is_refused_or_not_to_be_trusted() {
    let home = tempfile::tempdir().unwrap();
    let good = photographed(home.path(), SCENE, 2048);
    let mut wrong = Vec::new();
    for (what, scene, images, reason) in nonsense(&good) {
        let (verdict, said) = outcome(home.path(), &scene, &images);
        println!("== {what}: {verdict}\n{said}");
        if !["refused", "not-to-be-trusted"].contains(&verdict.as_str()) || !said.contains(reason) {
            wrong.push(format!("{what}: {verdict}, without {reason:?} in: {said}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn photographed(folder: &Path, scene: &str, paths: u32) -> Vec<RadianceImage> {
    std::fs::write(folder.join("s.toml"), scene).unwrap();
    let done = rig(
        folder,
        &format!("render --scene s.toml --out i.exr --spp {paths} --seed 5"),
    );
    assert!(done.status.success(), "{done:?}");
    let read = |light: usize| exr::read(&folder.join(format!("i_L{light:03}.exr"))).unwrap();
    (0..2).map(|light| read(light).image).collect()
}

/// Materials in and out of the dictionary's span, dark, bright, glossy and coloured ones.
#[test]
fn sound_images_are_not() {
    let home = tempfile::tempdir().unwrap();
    let brdf = SCENE.find("[brdf]").unwrap();
    let lobe = |weight: f64, alpha: f64, eta: f64, white: f64| {
        format!(
            "[brdf]\nmixture = [ {{ weight = {weight}, ggx = {{ alpha = {alpha}, eta = {eta} }} }}, {{ weight = {white}, lambertian = {{ albedo = 1.0 }} }}, {{ weight = {}, black = {{}} }} ]",
            1.0 - weight - white
        )
    };
    let materials = [
        SCENE[brdf..].to_owned(),
        lobe(0.0, 0.3, 1.5, 0.99),
        lobe(0.0, 0.3, 1.5, 0.02),
        lobe(0.9, 0.1, 1.5, 0.0),
        lobe(0.5, 0.06, 1.4, 0.3),
        lobe(0.9, 0.2, 2.8, 0.0),
        "[brdf]\nmixture = [ { weight = [0.8, 0.1, 0.0], lambertian = { albedo = 1.0 } }, { weight = [0.2, 0.9, 1.0], black = {} } ]".to_owned(),
    ];
    for material in materials {
        let scene = format!("{}{material}", &SCENE[..brdf]);
        let images = photographed(home.path(), &scene, 1024);
        let (verdict, said) = outcome(home.path(), &scene, &images);
        println!("== {material}: {verdict}\n{said}");
        assert!(
            ["explains", "reservations"].contains(&verdict.as_str()),
            "{material}: {verdict}: {said}"
        );
    }
}
