//! `rig calibrate glare` on the simulated bench, whose lens has glare, and a fit that takes it off.

use crate::command_support::{changed, good, printed_session, run, small_bench, text};
use serde_json::Value;

#[test]
fn glare_is_measured_and_taken_off() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let changes = [
        ("uniform = 0.0\nhalo = 0.0", "uniform = 0.003\nhalo = 0.002"),
        ("timing = \"realistic\"", "timing = \"instant\""),
        ("snr = 20.0", "snr = 5.0"),
        ("samples_per_pixel = 384", "samples_per_pixel = 64"),
        ("samples_per_pixel = 160", "samples_per_pixel = 16"),
    ];
    std::fs::write(
        at.join("rig.toml"),
        changed(small_bench::rig_file(), &changes),
    )
    .unwrap();
    small_bench::put_records(at);

    // The rehearsal finds what the simulated lens has.
    let measured = good(run(
        at,
        &["calibrate", "glare", "--rig", "rig.toml", "--json"],
    ));
    let found: Value = serde_json::from_str(&text(&measured.stdout)).unwrap();
    let number = |key: &str, part: &str| found[key][part].as_f64().unwrap();
    for (key, truth) in [("uniform", 0.003), ("halo", 0.002)] {
        let (value, std) = (number(key, "value"), number(key, "std"));
        assert!(
            (value - truth).abs() < 3.0 * std + 1e-4,
            "{key}: {value} ± {std}"
        );
        assert!(std < 1.5e-3, "{key}: {std}");
    }

    // A fit takes it off and says so.
    let capture = [
        "capture", "--rig", "rig.toml", "--light", "0,70", "--no-fit",
    ];
    let session = printed_session(&good(run(at, &capture)));
    let fitted = good(run(at, &["fit", session.to_str().unwrap()]));
    let said = text(&fitted.stderr);
    assert!(said.contains("veiling glare of 0."), "{said}");

    // A card is no trap.
    let card = [
        "calibrate",
        "glare",
        "--rig",
        "rig.toml",
        "--trap",
        "0,0,8,8",
    ];
    let refused = run(at, &card);
    let said = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{said}");
    assert!(
        said.contains("of the card's radiance; at most 10% can be glare"),
        "{said}"
    );
    assert!(
        said.contains("put a deep box, black inside, behind a hole in a white card"),
        "{said}"
    );
}
