//! `--port`, `--rig` and the rest: which rig a command talks to.

use super::remembered::{Memory, is_of_simulated_rig};
use super::simulated;
use anyhow::{Context, bail};
use parfocal::link::serial::{Serial, ports};
use parfocal::link::transport::Transport;
use parfocal::link::{Link, LinkError, LinkOptions};
use parfocal::rig::{AxisName, BoardId, Coordinate, Device, Rig};
use parfocal::stage::{Place, Stage, role};
use parfocal_protocol::message::Session;
use parfocal_protocol::units::Axis;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which rig to talk to.
#[derive(Clone, Debug, clap::Args)]
pub struct Connection {
    /// Serial port of a board; without it: the boards of the rig file, else the simulated rig
    #[arg(long, global = true, value_name = "PORT")]
    pub port: Vec<String>,
    /// The rig's file: which axis is on which board, and all calibrations
    #[arg(long, global = true, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Take control of the boards from another program, whose motion is stopped
    #[arg(long, global = true)]
    pub take_control: bool,
    /// Seed of everything random: a run can be repeated
    #[arg(long, global = true, default_value_t = 0)]
    pub seed: u64,
}

/// No cable of the simulated rig is ever pulled; in real time a busy computer may keep its boards from answering for seconds.
const SIMULATED_LINK: LinkOptions = LinkOptions { retry_ms: 100, deadline_ms: 10_000, reconnect_ms: 3000 };

/// The name of the simulated rig's port.
pub const SIMULATED: &str = "sim";

/// Whether a command moves things or only looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Read only.
    Look,
    /// Move and set.
    Control,
}

/// A connected rig.
pub struct Bench {
    /// Its axes.
    pub stage: Stage,
    /// The simulated rig, if this is it.
    pub simulated: Option<simulated::Handle>,
}

impl Connection {
    /// Whether the simulated rig is meant: said so, nothing said, or a rig's file whose boards are the simulated ones.
    pub fn is_simulated(&self) -> bool {
        match (&self.port[..], &self.rig) {
            ([], None) => true,
            ([], Some(path)) => Rig::load(path).is_ok_and(|rig| is_of_simulated_rig(&rig)),
            ([one], _) => one == SIMULATED,
            _ => false,
        }
    }

    /// The simulated rig, if it is meant. With a rig's file its axes are where the last command left them, and the
    /// objective that the file says is in use is in its light path.
    ///
    /// # Errors
    /// What is wrong with the rig's file, or with what is remembered beside it.
    pub fn simulated(&self, mut model: simulated::Model) -> anyhow::Result<Option<simulated::Handle>> {
        if !self.is_simulated() {
            return Ok(None);
        }
        if let Some(path) = &self.rig {
            let rig = Rig::load(path).with_context(|| path.display().to_string())?;
            model.objective = model.objective.or_else(|| rig.contents().objective_in_use.clone());
            // A recording takes an axis' place: nothing to remember.
            if model.limits.is_empty() {
                let memory = Memory::beside(path);
                let left = memory.recall()?;
                let mut positions: Vec<_> = left.positions.into_iter().collect();
                positions.append(&mut model.positions);
                (model.positions, model.set_down, model.memory) = (positions, left.set_down, Some(memory));
            }
        }
        Ok(Some(simulated::Handle::new(model)))
    }

    /// Connects, saying on stderr when it is to the simulated rig.
    ///
    /// # Errors
    /// What is wrong with a port or with the rig's file.
    pub fn open(&self, purpose: Purpose, model: simulated::Model) -> anyhow::Result<Bench> {
        let handle = self.simulated(model)?;
        let boards = handle.as_ref().map(|handle| handle as &dyn simulated::Boards);
        let stage = self.stage(purpose, boards, &mut |transport| transport)?;
        Ok(Bench { stage, simulated: handle })
    }

    /// The axes, each board's transport wrapped on its way to its link; on the simulated rig if there is one.
    ///
    /// # Errors
    /// What is wrong with a port or with the rig's file.
    pub fn stage(
        &self,
        purpose: Purpose,
        simulated: Option<&dyn simulated::Boards>,
        wrap: &mut dyn FnMut(Box<dyn Transport>) -> Box<dyn Transport>,
    ) -> anyhow::Result<Stage> {
        let rig =
            self.rig.as_deref().map(|path| Rig::load(path).with_context(|| path.display().to_string())).transpose()?;
        let role = role(purpose == Purpose::Control, self.take_control);
        let session = Session(fresh_session());
        if let Some(simulated) = simulated {
            match &self.rig {
                Some(path) => eprintln!("{}: this is the simulated rig", path.display()),
                None => eprintln!("no --port given: this is the simulated rig"),
            }
            let links = simulated
                .transports()
                .into_iter()
                .map(|transport| Link::open(wrap(transport), session, role, SIMULATED_LINK))
                .collect::<Result<Vec<_>, _>>()?;
            let axes = match &rig {
                Some(rig) if is_of_simulated_rig(rig) => places(Some(rig), &links)?,
                _ => simulated::axes(),
            };
            return Ok(Stage::new(links, axes));
        }
        let mut links: Vec<Link> = Vec::new();
        for port in self.ports(rig.as_ref())? {
            let link = match connect_through(&port, session, role, wrap) {
                Ok(link) => link,
                // Named by nobody: any port may be something else.
                Err(LinkError::NoAnswer { .. }) if self.port.is_empty() => continue,
                Err(error) => return Err(error.into()),
            };
            // A board is on two ports when both its USB and its debugger's cable are plugged in.
            if links.iter().any(|l| l.hello().unique_id == link.hello().unique_id) {
                link.close();
            } else {
                links.push(link);
            }
        }
        let axes = places(rig.as_ref(), &links)?;
        Ok(Stage::new(links, axes))
    }

    /// The latency of the rig's camera, if it was calibrated.
    ///
    /// # Errors
    /// What is wrong with the rig's file.
    pub fn latency(&self) -> anyhow::Result<Option<parfocal::frames::pacing::Latency>> {
        let Some(path) = &self.rig else { return Ok(None) };
        let rig = Rig::load(path).with_context(|| path.display().to_string())?;
        Ok(rig.contents().camera.as_ref().and_then(|c| c.latency.as_ref()).map(|l| l.in_force()))
    }

    fn ports(&self, rig: Option<&Rig>) -> anyhow::Result<Vec<String>> {
        if !self.port.is_empty() {
            return Ok(self.port.clone());
        }
        let found: Vec<String> = ports()?.into_iter().filter(|p| p.likely).map(|p| p.name).collect();
        if found.is_empty() && rig.is_some() {
            bail!("no port of this computer looks like a board: plug it in, or name it with --port");
        }
        Ok(found)
    }
}

/// Opens one port as a board.
///
/// # Errors
/// As [`Link::open`].
pub fn connect(port: &str, session: Session, role: parfocal_protocol::message::Role) -> Result<Link, LinkError> {
    connect_through(port, session, role, &mut |transport| transport)
}

fn connect_through(
    port: &str,
    session: Session,
    role: parfocal_protocol::message::Role,
    wrap: &mut dyn FnMut(Box<dyn Transport>) -> Box<dyn Transport>,
) -> Result<Link, LinkError> {
    let transport = Serial::open(port).map_err(LinkError::Port)?;
    Link::open(wrap(Box::new(transport)), session, role, LinkOptions::default())
}

/// A number for this program's session that no other running program has.
pub fn fresh_session() -> u32 {
    rand::random::<u32>().max(1)
}

/// A board's unique id as hexadecimal digits.
pub fn hex(id: &[u8]) -> String {
    id.iter().map(|b| format!("{b:02x}")).collect()
}

/// Which axis is where: by the rig's file, or the plain order of a single board.
fn places(rig: Option<&Rig>, links: &[Link]) -> anyhow::Result<BTreeMap<AxisName, Place>> {
    let Some(rig) = rig else {
        let [link] = links else {
            bail!("with several boards a rig file has to say which axis is where: `parfocal setup` writes one")
        };
        return Ok(plain_order(link.hello().axes));
    };
    let mut places = BTreeMap::new();
    for (device, axes) in &rig.contents().axes {
        for (coordinate, axis) in axes {
            let name = AxisName { device: *device, coordinate: *coordinate };
            let id = rig.contents().boards.get(&axis.board).map(|b| b.unique_id.clone());
            let board = links.iter().position(|l| id.as_ref().map(BoardId::as_str) == Some(&hex(&l.hello().unique_id)));
            match board {
                Some(board) => places.insert(name, Place { board, axis: Axis(axis.index) }),
                None => {
                    bail!("{name} is on board '{}', which is not connected: plug it in, or name its --port", axis.board)
                }
            };
        }
    }
    Ok(places)
}

/// A single board without a rig file: its axes are the microscope's x, y and z, then the first manipulator's x.
pub fn plain_order(axes: u8) -> BTreeMap<AxisName, Place> {
    let first = parfocal::rig::ManipulatorNumber::new(1).map(Device::Manipulator);
    let names = Coordinate::ALL
        .into_iter()
        .map(|coordinate| AxisName { device: Device::Scope, coordinate })
        .chain(first.into_iter().flat_map(|device| Coordinate::ALL.map(|coordinate| AxisName { device, coordinate })));
    names.zip(0..axes).map(|(name, i)| (name, Place { board: 0, axis: Axis(i) })).collect()
}

/// `path` in messages.
pub fn shown(path: &Path) -> String {
    path.display().to_string()
}
