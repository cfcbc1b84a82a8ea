//! `parfocal-emulator ELF`: plays scenarios on the emulated board. `cargo xtask emulate` calls it.

use parfocal_emulator::figures::Figures;
use parfocal_emulator::scenarios::ALL;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// What the command line says.
struct Arguments {
    elf: PathBuf,
    json: bool,
    figures: Figures,
    scenarios: Vec<String>,
}

const USAGE: &str = "usage: parfocal-emulator ELF [--json] [--flash-bytes N] [--ram-bytes N] [list | SCENARIO...]";

fn arguments() -> Option<Arguments> {
    let mut words = std::env::args().skip(1);
    let mut found =
        Arguments { elf: words.next()?.into(), json: false, figures: Figures::default(), scenarios: Vec::new() };
    while let Some(word) = words.next() {
        match word.as_str() {
            "--json" => found.json = true,
            "--flash-bytes" => found.figures.flash_bytes = words.next()?.parse().ok()?,
            "--ram-bytes" => found.figures.ram_bytes = words.next()?.parse().ok()?,
            name if name == "list" || ALL.iter().any(|s| s.name == name) => found.scenarios.push(word),
            _ => return None,
        }
    }
    Some(found)
}

fn main() -> ExitCode {
    let Some(Arguments { elf, json, mut figures, scenarios }) = arguments() else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    if scenarios.iter().any(|s| s == "list") {
        for scenario in ALL {
            println!("{:12} {}", scenario.name, scenario.shows);
        }
        return ExitCode::SUCCESS;
    }
    let mut failed = 0;
    for scenario in ALL.iter().filter(|s| scenarios.is_empty() || scenarios.iter().any(|n| n == s.name)) {
        let begin = Instant::now();
        let result = (scenario.play)(&elf, &mut figures);
        let seconds = begin.elapsed().as_secs_f64();
        let line = match result {
            Ok(said) => format!("{:12} ok      {said} ({seconds:.1} s)", scenario.name),
            Err(why) => {
                failed += 1;
                format!("{:12} FAILED  {why:#} ({seconds:.1} s)", scenario.name)
            }
        };
        if json { eprintln!("{line}") } else { println!("{line}") }
    }
    if json {
        println!("{}", serde_json::to_string(&figures).expect("figures are plain numbers"));
    }
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
