//! `rig shape` and `rig render`.

use std::path::Path;

use crate::command_support::{cases, ended, run};
use rig::frames::{MeshFile, Rigid, Sample};
use rig::geometry::{Mesh, Placement, Shape, files};
use rig::radiance_image::exr;
use serde_json::Value;

fn rig(folder: &Path, args: &[&str]) -> (bool, String, String) {
    let (code, out, said) = ended(&run(folder, args));
    (code == 0, out, said)
}

#[test]
fn every_kind_is_written_with_its_figures() {
    let folder = tempfile::tempdir().unwrap();
    for (args, file, mirrors) in [
        ("bowl", "a.obj", false),
        ("sphere --segments 32", "a.ply", false),
        ("cap", "a.stl", false),
        ("cap --opening 60", "a.stl", false),
        ("ridge", "a.ply", false),
        ("ridge --extruded --length 20", "a.obj", false),
        ("tetrahedron --depth -3", "a.stl", false),
        ("designed --segments 512", "b.PLY", true),
        ("groove --width 4", "b.obj", false),
        ("groove --profile vee", "b.stl", true),
    ] {
        let mut words = vec!["shape"];
        words.extend(args.split(' '));
        words.extend(["--out", file]);
        let (success, stdout, stderr) = rig(folder.path(), &words);
        assert!(success, "{args}: {stderr}");
        let figures: Value = serde_json::from_str(&stdout).unwrap();
        let mesh = files::read(&folder.path().join(file), &Placement::default()).unwrap();
        assert_eq!(figures["triangles"], mesh.triangles.len(), "{args}");
        let check = &figures["mirror_check"];
        assert_eq!(check.is_object(), mirrors, "{args}: {figures}");
        if mirrors {
            assert_eq!(check["returned_after_two"], check["rays"], "{args}");
            let worst = check["worst_deviation_deg"].as_f64().unwrap();
            println!("{args}: worst deviation {worst:.3}°");
            assert!(worst < 0.5, "{args}: {worst}");
        }
    }
}

#[test]
fn values_out_of_range_and_unusable_places_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("there.ply")).unwrap();
    std::os::unix::fs::symlink("/dev/null", folder.path().join("null.ply")).unwrap();
    for [args, expected] in cases(
        "
        bowl --segments 10 --out a.ply | not a multiple of 4 in 8 to 4096
        bowl --radius nan --out a.ply | not a number in 0.001 to 10000
        designed --offset 3 --out a.ply | not a number in 0 to 2
        cap --opening 180 --out a.ply | not a number in 5 to 170
        groove --width 20 --out a.ply | --width is 20, allowed is less than twice
        groove --profile vee --depth -1 --out a.ply | --depth is -1
        bowl --out a.step | does not end in .ply, .obj or .stl
        bowl --out there.ply | there.ply: it exists and is not a regular file
        bowl --out null.ply | null.ply: it exists and is not a regular file
        bowl --out no/a.ply | no/a.ply
    ",
    ) {
        let mut words = vec!["shape"];
        words.extend(args.split(' '));
        let (success, stdout, stderr) = rig(folder.path(), &words);
        assert!(!success && stdout.is_empty(), "{args}: {stdout}");
        assert!(stderr.contains(expected), "{args}: {stderr}");
    }
    assert!(!folder.path().join("a.ply").exists());
}

#[test]
fn coarse_facets_under_a_narrow_lobe_are_remarked_on() {
    let folder = tempfile::tempdir().unwrap();
    for (shading, alpha, remarked) in [
        ("flat", 0.05, true),
        ("flat", 0.9, false),
        ("smooth", 0.05, false),
    ] {
        let scene = format!(
            "[camera]\nmodel = \"orthographic\"\nresolution_px = [4, 4]\nextent_mm = [2.2, 2.2]\nposition_mm = [0, 0, 5]\n[[light]]\nkind = \"directional\"\nto_light = [0, 0, 1]\n[sample]\nshading = \"{shading}\"\nshape = {{ kind = \"bowl\", radius_mm = 1.0, segments = 64 }}\n[brdf]\nmixture = [ {{ weight = 1.0, ggx = {{ alpha = {alpha}, eta = 1.5 }} }} ]\n"
        );
        std::fs::write(folder.path().join("s.toml"), scene).unwrap();
        let args = [
            "render", "--scene", "s.toml", "--out", "a.exr", "--spp", "2",
        ];
        let (success, _, stderr) = rig(folder.path(), &args);
        assert!(success, "{stderr}");
        let found = stderr.contains("facets turn by 5.6");
        assert_eq!(found, remarked, "{shading} {alpha}: {stderr}");
    }
}

/// A bowl under coaxial light.
fn bowl_scene(extra: &str, brdf: &str) -> String {
    format!(
        "[camera]\nmodel = \"orthographic\"\nresolution_px = [12, 12]\nextent_mm = [1.6, 1.6]\nposition_mm = [0, 0, 5]\n[[light]]\nkind = \"directional\"\nto_light = [0, 0, 1]\n[sample]\nshape = {{ kind = \"bowl\", radius_mm = 1.0, segments = 64 }}\n{extra}[brdf]\n{brdf}\n"
    )
}

#[test]
fn a_render_says_what_its_longest_path_cuts_off() {
    let folder = tempfile::tempdir().unwrap();
    let white = "mixture = [ { weight = 1.0, lambertian = { albedo = 1.0 } } ]";
    std::fs::write(folder.path().join("s.toml"), bowl_scene("", white)).unwrap();
    let args = "render --scene s.toml --out a.exr --spp 64 --max-reflections 2 --json";
    let args: Vec<&str> = args.split(' ').collect();
    let (success, stdout, stderr) = rig(folder.path(), &args);
    assert!(success, "{stderr}");
    let answer: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(answer["images"][0], "a.exr");
    // Order k ≥ 2 is (1/4)(1/2)^(k−2)/π everywhere; the field shows all of the direct light.
    let share = answer["truncation"][0]["share"].as_f64().unwrap();
    let error = answer["truncation"][0]["standard_error"].as_f64().unwrap();
    let direct = 0.805;
    let exact = 0.25 / (direct + 0.5);
    assert!(
        (share - exact).abs() < 4.0 * error + 0.01,
        "{share} ± {error}"
    );
    assert!(
        stderr.contains("paths of more than 2 reflections, not followed, would add"),
        "{stderr}"
    );
}

#[test]
fn polarised_light_is_asked_for_in_either_way_and_refused_where_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let glass = "mixture = [ { weight = 1.0, ggx = { alpha = 0.4, eta = 1.5 } } ]";
    let polarised = "[render]\npolarised = true\n";
    let measured = "table = \"paper.bsdf\"";
    let paper = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/core/tests/data/brdf/paper_white_rgb.bsdf"
    );
    std::fs::copy(paper, folder.path().join("paper.bsdf")).unwrap();
    let render = |scene: String, more: &str| {
        std::fs::write(folder.path().join("s.toml"), scene).unwrap();
        let args = format!("render --scene s.toml --out a.exr --spp 16 --json{more}");
        let args: Vec<&str> = args.split(' ').collect();
        let (success, stdout, stderr) = rig(folder.path(), &args);
        let image = std::fs::read(folder.path().join("a.exr")).unwrap_or_default();
        (success, stdout, stderr, image)
    };
    let (_, plain, _, scalar) = render(bowl_scene("", glass), "");
    assert!(plain.contains("\"polarised\": false"), "{plain}");
    let (_, told, _, by_option) = render(bowl_scene("", glass), " --polarised");
    assert!(told.contains("\"polarised\": true"), "{told}");
    let (_, _, _, by_file) = render(bowl_scene(polarised, glass), "");
    assert!(by_option == by_file && by_file != scalar && !scalar.is_empty());
    let (success, _, stderr, _) = render(bowl_scene(polarised, measured), "");
    assert!(!success);
    assert!(
        stderr.contains("the sample's BRDF is no mixture of GGX, Lambertian and black")
            && stderr.contains("hint: "),
        "{stderr}"
    );
}

/// A scene of a sample with these keys, seen and lit along its axis.
fn scene_of(folder: &Path, name: &str, sample: &str) {
    let scene = format!(
        "[camera]\nmodel = \"orthographic\"\nresolution_px = [16, 16]\nextent_mm = [22.0, 22.0]\n\
         position_mm = [0.0, 0.0, 200.0]\n[[light]]\nkind = \"directional\"\n\
         to_light = [0.0, 0.0, 1.0]\nirradiance = 3.14\n[brdf]\n\
         mixture = [ {{ weight = 1.0, lambertian = {{ albedo = 0.5 }} }} ]\n[sample]\n{sample}\n"
    );
    std::fs::write(folder.join(name), scene).unwrap();
}

/// Renders a scene and returns its green channel, and what was said.
fn rendered(folder: &Path, scene: &str) -> (Vec<f32>, String) {
    let args = ["render", "--scene", scene, "--out", "o.exr", "--spp", "64"];
    let (success, _, stderr) = rig(folder, &args);
    assert!(success, "{scene}: {stderr}");
    let image = exr::read(&folder.join("o.exr")).unwrap().image;
    (image.mean.iter().map(|m| m[1]).collect(), stderr)
}

/// Part by which images differ.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    let off: f32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
    off / a.iter().sum::<f32>()
}

fn bowl() -> Mesh {
    let shape = Shape::Bowl {
        radius_mm: 10.0,
        segments: 64,
    };
    Mesh {
        normals: None,
        ..shape.mesh().unwrap()
    }
}

/// A bowl in metres, turned, elsewhere and inside out: the lines that are suggested make it
/// the bowl that it was, up to a turn about its axis.
#[test]
fn what_an_inspection_suggests_can_be_pasted() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let original = bowl();
    files::write(&at.join("original.stl"), &original).unwrap();
    let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 2.1, -0.7, 0.4);
    let file_from_sample: Rigid<MeshFile, Sample> =
        Rigid::new(turn, glam::DVec3::new(420.0, -33.0, 180.0));
    let mut exported = original.transformed(&file_from_sample);
    exported.positions_mm.iter_mut().for_each(|p| *p *= 1e-3);
    exported.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    files::write(&at.join("exported.ply"), &exported).unwrap();

    let (success, said, stderr) = rig(at, &["shape", "--inspect", "exported.ply"]);
    assert!(success, "{stderr}");
    let pasted: String = said
        .lines()
        .filter(|line| line.starts_with("mesh") || line.starts_with("flip"))
        .map(|line| format!("{line}\n"))
        .collect();
    assert_eq!(pasted.lines().count(), 4, "{said}");
    let smooth = "shading = \"smooth\"\n";
    scene_of(at, "a.toml", &format!("mesh = \"original.stl\"\n{smooth}"));
    scene_of(at, "b.toml", &format!("{pasted}{smooth}"));
    let ((a, _), (b, said)) = (rendered(at, "a.toml"), rendered(at, "b.toml"));
    assert!(!said.contains("warning"), "{said}");
    let off = difference(&a, &b);
    println!("off by {off}");
    assert!(off < 0.03, "{off}");

    // The same for programs.
    let (success, json, _) = rig(at, &["shape", "--inspect", "exported.ply", "--json"]);
    let found: Value = serde_json::from_str(&json).unwrap();
    assert!(success);
    assert_eq!(found["suggestion"]["mesh_unit"], "m");
    assert_eq!(found["suggestion"]["flip_facets"], true);
    assert_eq!(found["openings"][0]["corners"], 64);
    assert_eq!(found["is_closed"], false);
    let depth = found["hollow"]["depth"].as_f64().unwrap();
    assert!((depth - 0.01).abs() < 1e-6, "{depth}");
}

/// Smooth shading of a file without normals differs from flat, and is near to that with the
/// sphere's own normals.
#[test]
fn normals_are_made_for_a_file_that_has_none() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    files::write(&at.join("a.stl"), &bowl()).unwrap();
    let shape = "shape = { kind = \"bowl\", radius_mm = 10.0, segments = 64 }\n";
    scene_of(at, "flat.toml", "mesh = \"a.stl\"");
    scene_of(at, "made.toml", "mesh = \"a.stl\"\nshading = \"smooth\"");
    scene_of(at, "exact.toml", &format!("{shape}shading = \"smooth\""));
    let images = ["flat", "made", "exact"].map(|name| rendered(at, &format!("{name}.toml")).0);
    let [flat, made] = [0, 1].map(|i| difference(&images[2], &images[i]));
    println!("flat {flat}, made {made}");
    assert!(images[0] != images[1]);
    assert!(made < 0.75 * flat, "{made} {flat}");
}

/// More facets than are supported: said without reading them all into memory.
#[test]
fn a_mesh_of_too_many_facets_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\n\
                  property float y\nproperty float z\nelement face 20000001\n\
                  property list uchar uchar vertex_indices\nend_header\n";
    let mut bytes = header.as_bytes().to_vec();
    bytes.resize(header.len() + 20_000_001, 0);
    std::fs::write(folder.path().join("a.ply"), bytes).unwrap();
    let (success, _, stderr) = rig(folder.path(), &["shape", "--inspect", "a.ply"]);
    assert!(!success);
    assert!(
        stderr.contains("a.ply: the mesh has 20000001 triangles; at most 20000000"),
        "{stderr}"
    );
    assert!(stderr.contains("hint: reduce it"), "{stderr}");
}
