use std::convert::Infallible;

use super::*;

/// Holds nothing, and notes what it is asked for.
#[derive(Default)]
struct Asked(Vec<&'static str>);

impl Source for Asked {
    type Error = Infallible;

    fn integer(
        &mut self,
        key: &'static str,
        _: RangeInclusive<u64>,
    ) -> Result<Option<u64>, Infallible> {
        self.0.push(key);
        Ok(None)
    }

    fn number(
        &mut self,
        key: &'static str,
        _: RangeInclusive<f64>,
    ) -> Result<Option<f64>, Infallible> {
        self.0.push(key);
        Ok(None)
    }

    fn flag(&mut self, key: &'static str) -> Result<Option<bool>, Infallible> {
        self.0.push(key);
        Ok(None)
    }

    fn text(&mut self, key: &'static str) -> Result<Option<String>, Infallible> {
        self.0.push(key);
        Ok(None)
    }

    fn choice<T: Clone>(
        &mut self,
        key: &'static str,
        _: &[(&'static str, T)],
    ) -> Result<Option<T>, Infallible> {
        self.0.push(key);
        Ok(None)
    }
}

#[test]
fn the_command_line_has_the_options_that_are_read_by_key() {
    let mut asked = Asked::default();
    let Ok(request) = FitRequest::read(&mut asked).and_then(|read| read.read_machine(&mut asked));
    assert_eq!(request, FitRequest::default());
    let mut keys: Vec<&str> = asked.0;
    keys.extend(["mask", "uncertainty"]);
    keys.sort_unstable();

    let command = <FitRequest as clap::Args>::augment_args(clap::Command::new("fit"));
    command.clone().debug_assert();
    let mut ids: Vec<&str> = command
        .get_arguments()
        .map(|o| o.get_id().as_str())
        .collect();
    ids.sort_unstable();
    assert_eq!(ids, keys);
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
