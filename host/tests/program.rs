//! The command itself, as it is built: because this test is here, a build of all tests builds it, too.

use std::process::Command;

#[test]
fn the_command_says_who_it_is_and_what_it_can() {
    let said = |argument: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_parfocal")).arg(argument).output().expect("parfocal starts");
        assert!(output.status.success());
        String::from_utf8(output.stdout).expect("text")
    };
    assert_eq!(said("--version").trim(), concat!("parfocal ", env!("CARGO_PKG_VERSION")));
    for command in ["serve", "move", "autofocus", "calibrate", "goto", "stop"] {
        assert!(said("--help").lines().any(|line| line.trim_start().starts_with(command)), "{command}");
    }
}
