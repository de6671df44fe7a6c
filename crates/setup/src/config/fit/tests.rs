use std::collections::BTreeSet;
use std::path::Path;

use super::*;
use crate::config::reader::Section;

#[test]
fn the_command_line_has_the_options_that_are_read_by_key() {
    let mut table = Section::parse("", Path::new(""), "").unwrap();
    let request = FitRequest::read(&mut table).and_then(|read| read.read_machine(&mut table));
    assert_eq!(request.unwrap(), FitRequest::default());
    let keys = table.vocabulary().into_iter();
    let keys = keys.map(|key| match key.as_str() {
        "samples_per_pixel" => "samples_per_cell".to_owned(),
        _ => key,
    });
    let others = ["mask", "uncertainty", "left_out"].map(str::to_owned);
    let keys: BTreeSet<String> = keys.chain(others).collect();

    let command = <FitRequest as clap::Args>::augment_args(clap::Command::new("fit"));
    command.clone().debug_assert();
    let ids = command
        .get_arguments()
        .map(|option| option.get_id().to_string());
    assert_eq!(ids.collect::<BTreeSet<_>>(), keys);
}

#[test]
fn words_of_the_command_line_become_a_request() {
    let parse = |words: &str| {
        let command = <FitRequest as clap::Args>::augment_args(clap::Command::new("fit"));
        let words = format!("fit {words}");
        let matches = command.try_get_matches_from(words.split_whitespace());
        matches.map(|matches| {
            <FitRequest as clap::FromArgMatches>::from_arg_matches(&matches).unwrap()
        })
    };
    // The default asks for nothing, not even for a kernel: a batch states its own.
    for nothing in ["", "--kernel auto"] {
        assert_eq!(parse(nothing).unwrap(), FitRequest::default(), "{nothing}");
    }
    let request = FitRequest {
        optimizer: Some(Optimizer::SingleBounce),
        samples_per_cell: Some(2),
        channels: Some(Channels::Shared),
        model_error: Some(0.0),
        cells: Some(64),
        kernel: Some(Kernel::Avx2),
        refine_bench: Some(false),
        ..FitRequest::default()
    };
    let words = "--optimizer single-bounce --spp 2 --shared-weights --model-error 0 --cells 64 \
                 --kernel avx2 --refine-bench=false";
    assert_eq!(parse(words).unwrap(), request);
    for (bad, said) in [
        ("--spp=-1", "-1 is not in 2..=65536"),
        ("--max-reflections 65", "65 is not in 2..=64"),
        ("--model-error 2", "not in 0 to 1"),
        ("--model-error x", "not a number"),
        ("--cells 63", "63 is not in 64..=100000"),
        ("--memory 15", "15 is not in 16..=1048576"),
        (
            "--kernel neon",
            "[possible values: portable, avx2, avx512, auto]",
        ),
        ("--pose p.toml", "unexpected argument"),
    ] {
        let error = parse(bad).unwrap_err().to_string();
        assert!(error.contains(said), "{bad}: {error}");
    }
}
