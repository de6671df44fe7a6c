//! The `rig` program; everything is in [`rig::cli`].

fn main() -> std::process::ExitCode {
    rig::cli::main()
}
