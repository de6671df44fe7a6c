//! The commands of docs/recipes.md, run as they stand there, on small spheres and with a
//! small dictionary.

use crate::command_support::words;
use crate::fitted_session;

use std::os::unix::fs::symlink;
use std::process::Command;

/// The blocks of the page that are shell commands.
fn blocks() -> Vec<String> {
    let page = include_str!("../../docs/recipes.md");
    let blocks = page.split("```sh\n").skip(1);
    let blocks = blocks.map(|rest| rest.split("```").next().unwrap_or(rest).to_owned());
    blocks.collect()
}

#[test]
fn every_recipe_does_what_it_says() {
    let home = tempfile::tempdir().unwrap();
    let session = fitted_session::session(home.path(), &fitted_session::fit(true), "", true);
    symlink(&session, home.path().join("SESSION")).unwrap();
    let programs = home.path().join("bin");
    std::fs::create_dir(&programs).unwrap();
    symlink(env!("CARGO_BIN_EXE_rig"), programs.join("rig")).unwrap();
    let path = format!("{}:/usr/bin:/bin", programs.display());

    let two = "atoms = [{ type = \"ggx\", alpha = 0.1, eta = 1.5 }, { type = \"lambertian\", albedo = 1.0 }]";
    std::fs::write(home.path().join("two.toml"), two).unwrap();
    let angles = "theta_i_deg,theta_o_deg,phi_deg\n45,45,180\n";
    std::fs::write(home.path().join("angles.csv"), angles).unwrap();
    let blocks = blocks();
    assert!(blocks.len() >= 8, "{} blocks", blocks.len());
    for block in &blocks {
        let quick = block
            .replace("rig brdf compare", "rig brdf compare --size 12")
            .replace("rig brdf project", "rig brdf project --size 12")
            .replace("--dictionary paper42", "--dictionary two.toml")
            .replace("*.binary", "back.binary")
            .replace("--out red.png", "--size 12 --out red.png")
            .replace("--out spheres.png", "--size 12 --out spheres.png");
        let done = Command::new("sh")
            .args(["-euc", &quick])
            .current_dir(home.path())
            .env("PATH", &path)
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{block}\n{stderr}");
        assert!(!done.stdout.is_empty(), "{block}");
    }

    // What they name is there, and is of its kind.
    let starts = |name: &str| std::fs::read(home.path().join(name)).unwrap()[..5].to_vec();
    for (name, start) in [
        ("red.bsdf", b"tenso"),
        ("sample.xml", b"<?xml"),
        ("lobes.svg", b"<svg "),
        ("slices.png", b"\x89PNG\r"),
        ("difference.png", b"\x89PNG\r"),
        ("certificate.html", b"<!DOC"),
        ("result.json", b"{\"dat"),
        ("weights.csv", b"atom,"),
    ] {
        assert_eq!(starts(name), start, "{name}");
    }
    // There and back: RGL's values at the horizon, f·cos θ over cos θ, are not spread.
    let done = Command::new(programs.join("rig"))
        .args(words(
            "brdf compare back.binary red.binary --size 12 --json",
        ))
        .current_dir(home.path())
        .output()
        .unwrap();
    let lost: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    let lost = lost["environment"]["mean"]["all"].as_f64().unwrap();
    assert!(lost < 0.03, "{lost}");

    let errors = std::fs::read(home.path().join("errors.json")).unwrap();
    let errors: serde_json::Value = serde_json::from_slice(&errors).unwrap();
    assert!(errors["albedo"][0]["difference"][2].is_number(), "{errors}");
}
