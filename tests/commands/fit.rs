//! `rig fit` on images of a described scene: what its options do, and how the fit's record
//! states them.

use std::path::Path;
use std::sync::Mutex;

use crate::command_support::{cases, run_line as rig};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, LumaA, Rgba, RgbaImage};
use rig::inverse::Channels;
use rig::progress::Progress;
use rig::session::fit_record::{self, FitRecord, Grade, Verdict, Warning};
use rig::transport::Kernel;
use rig::workflow::{FitRequest, ImageFit, Notice, Observer, fit_images};

const SCENE: &str = r#"
[camera]
model = "orthographic"
resolution_px = [16, 16]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]

[[light]]
kind = "directional"
to_light = [0.0, 0.0, 1.0]
irradiance = 3.14

[[light]]
kind = "directional"
to_light = [0.4, 0.1, 0.9]
irradiance = 3.14

[sample]
shape = { kind = "bowl", radius_mm = 1.0, segments = 48 }
shading = "smooth"

[brdf]
mixture = [
  { weight = [0.4, 0.3, 0.2], lambertian = { albedo = 1.0 } },
  { weight = 0.2, ggx = { alpha = 0.3, eta = 1.5 } },
  { weight = [0.4, 0.5, 0.6], black = {} },
]

[uncertainty]
light_deg = 0.1
intensity = 0.0
rotation_deg = 0.0
translation_mm = 0.0
"#;

const FIT: &str = "fit --scene s.toml --image i_L000.exr i_L001.exr --spp 32 --kernel portable";

/// A folder with a scene and its images.
fn photographed() -> tempfile::TempDir {
    let home = tempfile::tempdir().unwrap();
    std::fs::write(home.path().join("s.toml"), SCENE).unwrap();
    let done = rig(
        home.path(),
        "render --scene s.toml --out i.exr --spp 128 --seed 5",
    );
    assert!(done.status.success(), "{done:?}");
    home
}

/// The folder of the fit with these options.
fn folder_of(options: &str) -> String {
    format!("fit{}", options.replace(['-', ' ', '=', '.'], ""))
}

fn fitted(folder: &Path, options: &str) -> FitRecord {
    let name = folder_of(options);
    let done = rig(folder, &format!("{FIT} --out {name} {options}"));
    let stderr = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{options}: {stderr}");
    fit_record::read(&folder.join(name)).unwrap()
}

/// Of a bowl under lamps that are described 25% too bright, with a scale of which nothing is
/// known: it follows from how strong the interreflections are.
#[test]
fn a_free_common_scale_is_found() {
    let light = |to_light: &str| {
        format!("[[light]]\nkind = \"directional\"\nto_light = {to_light}\nirradiance = 3.14\n")
    };
    let more = ["[-0.35, 0.61, 0.71]", "[-0.2, -0.55, 0.81]"].map(light);
    let free = SCENE
        .replace("[16, 16]", "[24, 24]")
        .replace("[sample]", &format!("{}[sample]", more.concat()))
        .replace("light_deg = 0.1", "light_deg = 0.0")
        .replace(
            "intensity = 0.0",
            "intensity = 0.01\ncommon_intensity = 1.0",
        );
    let home = tempfile::tempdir().unwrap();
    let write = |name: &str, scene: &str| std::fs::write(home.path().join(name), scene).unwrap();
    write("s.toml", &free.replace("segments = 48", "segments = 240"));
    let done = rig(
        home.path(),
        "render --scene s.toml --out i.exr --spp 1024 --seed 77",
    );
    assert!(done.status.success(), "{done:?}");
    let described = free.replace("segments = 48", "segments = 128");
    write("s.toml", &described.replace("3.14", "3.925"));
    let done = rig(
        home.path(),
        "fit --scene s.toml --image i_L000.exr i_L001.exr i_L002.exr i_L003.exr --spp 256 \
         --kernel portable --out fit --refine-bench",
    );
    assert!(done.status.success(), "{done:?}");
    let record = fit_record::read(&home.path().join("fit")).unwrap();
    assert_eq!(scale_reservation(&record), None);
    let bench = record.bench.unwrap();
    assert!(bench.settled);
    assert_eq!(bench.parameter.len(), 4);
    for lamp in &bench.parameter {
        let off = lamp.value - 0.8f64.ln();
        println!(
            "{}: off by {off:+.4}, stated {:.4}",
            lamp.name, lamp.deviation
        );
        assert!(off.abs() < 3.0 * lamp.deviation, "{lamp:?}");
        assert!(lamp.deviation < 0.05, "{lamp:?}");
    }
}

#[test]
fn the_record_states_how_the_fit_was_made() {
    let home = photographed();
    let mut mask = GrayImage::from_pixel(16, 16, Luma([255]));
    for y in 0..16 {
        for x in 0..4 {
            mask.put_pixel(x, y, Luma([0]));
        }
    }
    mask.save(home.path().join("m.png")).unwrap();

    let plain = fitted(home.path(), "");
    let settings = &plain.settings;
    assert_eq!(settings.optimizer, "gauss-newton");
    assert_eq!(settings.samples_requested, Some(32));
    let asked = FitRequest {
        channels: Some(Channels::Separate),
        model_error: Some(0.02),
        memory_mib: Some(512),
        ..FitRequest::default()
    };
    assert_eq!(settings.asked, asked);
    assert_eq!(settings.adapted_paths, Some(true));
    assert_eq!(settings.scene.as_deref(), Some("s.toml"));
    assert_eq!(settings.images, ["i_L000.exr", "i_L001.exr"]);
    assert!(plain.bench.is_none());
    assert_eq!(plain.remarks, [""; 0]);

    let options = "--mask m.png --shared-weights --model-error 0.05 --memory 64";
    let other = fitted(home.path(), options);
    let settings = &other.settings;
    let asked = FitRequest {
        channels: Some(Channels::Shared),
        model_error: Some(0.05),
        mask: Some("m.png".into()),
        memory_mib: Some(64),
        ..FitRequest::default()
    };
    assert_eq!(settings.asked, asked);
    // The same weights, and nothing compared where the mask is black.
    assert_eq!(other.weights[0], other.weights[2]);
    assert_ne!(plain.weights[0], plain.weights[2]);
    let residual = home
        .path()
        .join(folder_of(options))
        .join("residual_L000.exr");
    let residual = rig::radiance_image::exr::read(&residual).unwrap().image;
    let sums = [0..4, 4..16].map(|columns| {
        let pixels = (0..16).flat_map(|y| columns.clone().map(move |x| y * 16 + x));
        pixels.map(|p| residual.mean[p][0].abs()).sum::<f32>()
    });
    assert!(sums[0] == 0.0 && sums[1] > 0.0, "{sums:?}");
}

/// Phases and notices, one line each.
#[derive(Default)]
struct Seen(Mutex<Vec<String>>);

impl Progress for Seen {
    fn begin(&self, phase: &str, _: Option<usize>) {
        self.0.lock().unwrap().push(phase.to_owned());
    }
}

impl Observer for Seen {
    fn notice(&self, notice: Notice<'_>) {
        self.0.lock().unwrap().push(notice.to_string());
    }
}

#[test]
fn the_library_fits_as_the_command_does() {
    let home = photographed();
    let by_command = fitted(home.path(), "");
    let images = ["i_L000.exr", "i_L001.exr"].map(|name| home.path().join(name));
    let files = ImageFit {
        scene: &home.path().join("s.toml"),
        images: &images,
        out: &home.path().join("by-library"),
    };
    let request = FitRequest {
        samples_per_cell: Some(32),
        kernel: Some(Kernel::Portable),
        ..FitRequest::default()
    };
    let seen = Seen::default();
    let outcome = fit_images(files, &request, &seen).unwrap();
    assert_eq!(outcome.record.weights, by_command.weights);
    assert_eq!(outcome.record.table, by_command.table);
    assert_eq!(fit_record::find(&outcome.folder).unwrap(), outcome.record);
    let seen = seen.0.into_inner().unwrap();
    for line in ["tracing paths", "uncertainty"] {
        assert!(seen.iter().any(|seen| seen == line), "{seen:?}");
    }
    assert!(seen[0].contains("32 light paths each"), "{seen:?}");
}

/// Remarks at the terminal are in the record too, without effect on its verdict.
#[test]
fn remarks_stay_with_the_fit() {
    let home = photographed();
    let flat = SCENE.replace("\"smooth\"", "\"flat\"");
    std::fs::write(home.path().join("flat.toml"), flat).unwrap();
    let images = "--image i_L000.exr i_L001.exr";
    let done = rig(
        home.path(),
        &format!("fit --scene flat.toml {images} --spp 4096 --memory 40 --out flat --json"),
    );
    let stderr = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{stderr}");
    let record = fit_record::read(&home.path().join("flat")).unwrap();
    let [coarse, fewer] = &record.remarks[..] else {
        panic!("{:?}", record.remarks);
    };
    assert!(coarse.contains("facets turn by 7.52°"), "{coarse}");
    assert!(fewer.contains("of 4096 paths per cell"), "{fewer}");
    assert!(
        stderr.contains(coarse) && stderr.contains(fewer),
        "{stderr}"
    );
    let told: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(told["remarks"], serde_json::json!(record.remarks));
}

/// Another program's image, which states no variance, is fitted with an assumed one, and the
/// record names that image.
#[test]
fn noise_that_no_image_states_is_remarked_on() {
    let home = photographed();
    let known = rig::radiance_image::exr::read(&home.path().join("i_L001.exr")).unwrap();
    let bare = home.path().join("bare.exr");
    exr::prelude::write_rgb_file(&bare, 16, 16, |x, y| {
        let [r, g, b] = known.image.mean[16 * y + x];
        (r, g, b)
    })
    .unwrap();
    let done = rig(
        home.path(),
        "fit --scene s.toml --image i_L000.exr bare.exr --spp 32 --out bare",
    );
    let stderr = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{stderr}");
    let record = fit_record::read(&home.path().join("bare")).unwrap();
    let [remark] = &record.remarks[..] else {
        panic!("{:?}", record.remarks);
    };
    assert!(
        remark.starts_with("bare.exr: no variance is stated"),
        "{remark}"
    );
    assert!(stderr.contains(remark), "{stderr}");
}

#[test]
fn other_optimisers_and_a_refined_bench() {
    let home = photographed();
    let gradient = fitted(home.path(), "--optimizer exponentiated-gradient");
    assert_eq!(gradient.settings.optimizer, "exponentiated-gradient");
    let once = fitted(home.path(), "--optimizer single-bounce");
    assert_eq!(once.settings.optimizer, "single-bounce");

    let refined = fitted(
        home.path(),
        "--refine-bench --uncertainty intensity=0.01 --uncertainty stray_light=0.001",
    );
    let bench = refined.bench.as_ref().unwrap();
    let names: Vec<&str> = bench.parameter.iter().map(|p| p.name.as_str()).collect();
    for name in [
        "azimuth of light 1",
        "elevation of light 2",
        "intensity of light 2",
        "stray light in image 1",
    ] {
        assert!(names.contains(&name), "{name} in {names:?}");
    }
    assert!(names.iter().all(|name| !name.contains("rotation")));
    for p in &bench.parameter {
        // The images were rendered on the bench as described.
        assert!(p.value.abs() < 5.0 * p.prior_deviation, "{p:?}");
        assert!(p.deviation <= 1.001 * p.prior_deviation, "{p:?}");
    }
    assert_eq!(scale_reservation(&refined), None);
}

/// What a fit says of a scale that it does not know.
fn scale_reservation(fit: &FitRecord) -> Option<&str> {
    let says = |w: &&Warning| {
        w.what.contains("irradiance is known within") || w.what.contains("determines the scale")
    };
    let warning = fit.warnings.iter().find(says)?;
    assert_eq!(warning.grade, Grade::Reservation);
    assert!(warning.likely_cause.contains("rig calibrate white"));
    Some(&warning.what)
}

/// A sphere has no interreflection: a darker lamp and a brighter material make the same images.
/// The irradiance stays as stated, whatever that is, and as uncertain as stated.
#[test]
fn a_scale_that_nothing_shows_is_as_stated() {
    let home = tempfile::tempdir().unwrap();
    let scene = SCENE
        .replace(
            "{ kind = \"bowl\", radius_mm = 1.0, segments = 48 }",
            "{ kind = \"sphere\", radius_mm = 1.0, segments = 48 }",
        )
        .replace(
            "intensity = 0.0",
            "intensity = 0.01\ncommon_intensity = 1.0",
        );
    std::fs::write(home.path().join("s.toml"), &scene).unwrap();
    let done = rig(
        home.path(),
        "render --scene s.toml --out i.exr --spp 128 --seed 5",
    );
    assert!(done.status.success(), "{done:?}");
    // The last explains the images by a material that is nearly white.
    for (stated, options) in [
        ("3.14", "--refine-bench"),
        ("12.56", "--refine-bench --seed 2"),
        ("2.6", "--refine-bench --seed 3"),
    ] {
        let scene = scene.replace("3.14", stated);
        std::fs::write(home.path().join("s.toml"), scene).unwrap();
        let fit = fitted(home.path(), options);
        let what = scale_reservation(&fit).unwrap_or_default();
        assert!(
            what.contains("nothing in these images determines the scale"),
            "{stated}: {:?}",
            fit.warnings
        );
        assert_ne!(fit.verdict(), Verdict::Explains);
        let bench = fit.bench.unwrap();
        let scale = "intensity of all lights against the sample's albedo";
        assert!(bench.held.iter().any(|held| held == scale), "{bench:?}");
        for lamp in bench
            .parameter
            .iter()
            .filter(|p| p.name.starts_with("intensity"))
        {
            assert!(lamp.value.abs() < 0.1, "{stated}: {lamp:?}");
            assert!(lamp.deviation > 0.9, "{stated}: {lamp:?}");
        }
    }
}

/// One mask as greys, with transparency in place of black, with 16 bits, and with both.
#[test]
fn a_mask_leaves_what_is_white_and_opaque() {
    let home = photographed();
    let white = |x: u32, y: u32| (4..12).contains(&x) && y > 3;
    let luma = |x, y| if white(x, y) { 255 } else { 0 };
    let save = |name: &str, mask: DynamicImage| mask.save(home.path().join(name)).unwrap();
    save(
        "grey.png",
        GrayImage::from_fn(16, 16, |x, y| Luma([luma(x, y)])).into(),
    );
    save(
        "clear.png",
        RgbaImage::from_fn(16, 16, |x, y| Rgba([255, 255, 255, luma(x, y)])).into(),
    );
    type Deep = ImageBuffer<LumaA<u16>, Vec<u16>>;
    save(
        "deep.png",
        Deep::from_fn(16, 16, |x, y| LumaA([65535, 257 * u16::from(luma(x, y))])).into(),
    );
    let cells = |mask: &str| {
        let options = format!("--mask {mask} --seed 3");
        fitted(home.path(), &options);
        let folder = home.path().join(folder_of(&options));
        std::fs::read_to_string(folder.join("cells.csv"))
            .unwrap()
            .lines()
            .count()
    };
    let grey = cells("grey.png");
    assert_eq!([cells("clear.png"), cells("deep.png")], [grey; 2]);
    assert!(grey < 16 * 16);
}

/// The order of a shell's pattern is not that of the numbers.
#[test]
fn images_out_of_order_are_said_before_the_fit() {
    let home = photographed();
    let path = |name: &str| home.path().join(name);
    std::fs::rename(path("i_L000.exr"), path("light10.exr")).unwrap();
    std::fs::rename(path("i_L001.exr"), path("light2.exr")).unwrap();
    let fit = "fit --scene s.toml --spp 8 --dictionary rig26 --image";
    let said = |images: &str, out: &str| {
        let done = rig(home.path(), &format!("{fit} {images} --out {out}"));
        let stderr = String::from_utf8(done.stderr).unwrap();
        assert!(done.status.success(), "{stderr}");
        stderr
    };
    let stderr = said("light10.exr light2.exr", "a");
    let remark = "the numbers in the images' names are not in order: light10.exr, light2.exr";
    let before = |first: &str, second: &str| stderr.find(first) < stderr.find(second);
    assert!(stderr.contains(remark), "{stderr}");
    assert!(before(remark, "paths per cell"), "{stderr}");
    let record = fit_record::read(&path("a")).unwrap();
    assert!(record.remarks[0].starts_with(remark), "{record:?}");
    assert!(!said("light2.exr light10.exr", "b").contains("not in order"));
}

#[test]
fn options_that_would_do_nothing_are_refused() {
    let home = photographed();
    for [options, fact, hint] in cases("
        --uncertainty light_deg=0.5 | the bench is not refined | add --refine-bench, or leave --uncertainty out
        --refine-bench --uncertainty light=0.5 | light_deg |
        --mask gone.png | gone.png | a mask is a PNG of the images' size
    ") {
        let done = rig(home.path(), &format!("{FIT} --out no {options}"));
        let stderr = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(1), "{options}: {stderr}");
        assert!(stderr.contains(fact), "{options}: {stderr}");
        let (_, advice) = stderr.split_once("\n\nhint: ").unwrap();
        assert!(advice.contains(hint), "{options}: {stderr}");
        assert!(!home.path().join("no").exists());
    }
    let done = rig(home.path(), "render --scene s.toml --out i.png");
    assert_eq!(done.status.code(), Some(1));
    assert!(!home.path().join("i.png").exists());
}

/// What would take more memory than is allowed is refused before anything is traced, with what
/// would do; that then does.
#[test]
fn a_fit_beyond_its_memory_is_refused_with_what_would_do() {
    let home = photographed();
    let refused = |words: &str| {
        let done = rig(home.path(), words);
        let stderr = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(1), "{words}: {stderr}");
        assert!(stderr.contains("of memory, but"), "{words}: {stderr}");
        stderr
    };
    let said =
        refused("fit --scene s.toml --image i_L000.exr i_L001.exr --out refused --memory 16");
    let enough = said
        .split("`--memory ")
        .nth(1)
        .and_then(|rest| rest.split('`').next());
    let enough: u64 = enough.unwrap().parse().unwrap();
    assert!((17..256).contains(&enough), "{said}");
    assert!(!home.path().join("refused").exists());
    let quick = "--spp 2 --optimizer single-bounce";
    let done = rig(
        home.path(),
        &format!("{FIT} {quick} --out done --memory {enough}").replace("--spp 32", ""),
    );
    assert!(done.status.success(), "{done:?}");
}

/// Sizes are compared before anything is decoded: an image that would fill the memory, one that
/// is a little larger, and a mask of another size.
#[test]
fn images_of_another_size_are_refused_by_their_headers() {
    let home = photographed();
    let bomb = include_bytes!("../../fuzz/corpus/exr/bomb");
    std::fs::write(home.path().join("bomb.exr"), bomb).unwrap();
    let other = SCENE.replace("[16, 16]", "[17, 16]");
    std::fs::write(home.path().join("other.toml"), other).unwrap();
    GrayImage::new(16, 17)
        .save(home.path().join("mask.png"))
        .unwrap();
    for (words, fact) in [
        (
            "fit --scene s.toml --image i_L000.exr bomb.exr",
            "bomb.exr is 4096 x 4096 pixels; the camera's image is 16 x 16",
        ),
        (
            "fit --scene other.toml --image i_L000.exr i_L001.exr",
            "i_L000.exr is 16 x 16 pixels; the camera's image is 17 x 16",
        ),
        (
            "fit --scene s.toml --image i_L000.exr i_L001.exr --mask mask.png",
            "mask.png: it is 16 x 17 pixels; 16 x 16 are needed",
        ),
        // Nobody knows the size here, but no image of so few bytes has so many pixels.
        (
            "calibrate white bomb.exr --rig simulated --reflectance 0.9 --reflectance-std 0.01",
            "bytes cannot hold",
        ),
    ] {
        let out = if words.starts_with("fit") {
            " --out o"
        } else {
            ""
        };
        let done = rig(home.path(), &format!("{words}{out}"));
        let stderr = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(1), "{words}: {stderr}");
        assert!(stderr.contains(fact), "{words}: {stderr}");
    }
}

/// One of two lights is fitted and the other predicted.
#[test]
fn a_light_that_was_not_fitted_is_predicted() {
    let home = photographed();
    let validate = "validate --scene s.toml --image i_L000.exr i_L001.exr --spp 32 --json";
    let done = rig(home.path(), &format!("{validate} --fit-lights 2 --out v"));
    assert!(done.status.success(), "{done:?}");
    let found: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(found["fitted_lights"], serde_json::json!([1]));
    assert_eq!(found["lights"][0]["light"], 0);
    assert_eq!(found["images"][0], "i_L000.exr");
    let error = found["all"]["overall"]["relative_rms"].as_f64().unwrap();
    let coverage = found["all"]["coverage"].as_f64().unwrap();
    assert!(error < 0.08 && coverage > 0.85, "{found}");

    // What is kept is what was printed, with a picture; a folder is never written over.
    let kept = std::fs::read(home.path().join("v/validation.json")).unwrap();
    let kept = rig::session::validation::parse("v".as_ref(), &kept).unwrap();
    assert_eq!(serde_json::to_value(kept).unwrap(), found);
    let picture = image::open(home.path().join("v/light_L000.png")).unwrap();
    assert!(picture.width() > picture.height(), "{picture:?}");
    let again = rig(home.path(), &format!("{validate} --fit-lights 2 --out v"));
    assert_eq!(again.status.code(), Some(1));

    // The images of a wrong order are remarked on, as before a fit.
    let exchanged = validate.replace("i_L000.exr i_L001.exr", "i_L001.exr i_L000.exr");
    let stderr = rig(home.path(), &exchanged).stderr;
    let stderr = String::from_utf8_lossy(&stderr);
    assert!(stderr.contains("i_L001.exr, i_L000.exr"), "{stderr}");

    let refused = rig(home.path(), &format!("{validate} --hold-out 2"));
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        stderr.contains("2 of 2 lights are to be predicted; allowed are 1 to 1")
            && stderr.contains("a quarter of the lights is predicted"),
        "{stderr}"
    );
}
