//! Which objective is in the light path: a wrong one breaks pipettes.

use super::desk::{Desk, Level};
use super::order::OrderError;
use super::wizard::AskedFor;
use crate::rig::Objective;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Turns the microscope's own turret to an objective; a sentence when it cannot.
pub type Turret = Box<dyn Fn(&str) -> Result<(), String> + Send + Sync>;

/// Longest name of an objective.
const NAME: usize = 40;

/// Puts an objective in use: turns the turret if the microscope has one, and keeps it in the rig's file. A new one is added.
///
/// # Errors
/// There is no such objective, there is one already, or the file cannot be written.
pub fn put_in_use(desk: &Desk, name: &str, new: bool) -> Result<(), OrderError> {
    let wrong = |text: String| Err(OrderError::Value(text));
    {
        let rig = desk.rig();
        let known = &rig.contents().objectives;
        let names = || known.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        if new && known.contains_key(name) {
            return wrong(format!("objective '{name}' is known already: choose it from the list"));
        }
        if !new && !known.contains_key(name) {
            return wrong(format!("there is no objective '{name}' in the rig's file; it has {}", names()));
        }
        if new && (name.trim() != name || name.is_empty() || name.len() > NAME || name.chars().any(char::is_control)) {
            return wrong(format!("an objective's name has 1 to {NAME} characters, as in 20x"));
        }
    }
    if let Some(turret) = &desk.turret {
        turret(name).map_err(OrderError::Value)?;
    }
    let mut rig = desk.rig();
    let contents = rig.contents_mut();
    if new {
        let default = contents.objectives.is_empty();
        contents.objectives.insert(name.into(), Objective { default, ..Objective::default() });
    }
    contents.objective_in_use = Some(name.into());
    if let Some(path) = &desk.rig_path {
        rig.save(path).map_err(|e| OrderError::Value(e.to_string()))?;
    }
    drop(rig);
    desk.tell(Level::Info, format!("objective {name} is in use"));
    Ok(())
}

/// Asks the person for an objective, in the middle of a procedure, and puts it in use once they say that it is there.
///
/// # Errors
/// A sentence: nobody said so, or it cannot be.
pub fn ask_for(desk: &Desk, going: &dyn Fn() -> bool, name: &str) -> Result<(), String> {
    if desk.rig().contents().objective_in_use.as_deref() == Some(name) {
        return Ok(());
    }
    let (answers, answered) = sync_channel(1);
    desk.wizard().ask(AskedFor::Objective, name.into(), Some(answers));
    loop {
        match answered.recv_timeout(Duration::from_millis(50)) {
            Ok(()) => break,
            Err(RecvTimeoutError::Timeout) if going() => {}
            Err(_) => return Err("nobody said that it was".into()),
        }
    }
    put_in_use(desk, name, false).map_err(|e| e.to_string())
}
