//! A board on a serial port: USB CDC-ACM, a debugger's virtual port, or a pseudo-terminal.

use super::transport::{Transport, real_now};
use parfocal_protocol::units::HostTime;
use serialport::{ErrorKind, SerialPort, SerialPortType};
use std::io;
use std::io::{Read as _, Write as _};
use std::time::Duration;

/// Speed of the wired port; USB and pseudo-terminals ignore it.
const BAUD: u32 = 921_600;

/// An open serial port.
pub struct Serial {
    path: String,
    port: Option<Box<dyn SerialPort>>,
}

impl Serial {
    /// Opens a port for this program alone.
    ///
    /// # Errors
    /// One sentence on why not: no such port, no permission, another program has it.
    pub fn open(path: &str) -> io::Result<Self> {
        Ok(Self { path: path.into(), port: Some(open(path)?) })
    }
}

fn open(path: &str) -> io::Result<Box<dyn SerialPort>> {
    let mut port = serialport::new(path, BAUD).timeout(Duration::from_millis(5)).open_native().map_err(|e| {
        let text = match e.kind() {
            // The port is there, but another program has locked it.
            ErrorKind::NoDevice if std::path::Path::new(path).exists() => {
                format!("{path} is in use: close the other program that talks to this board")
            }
            ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::NotFound) => {
                format!("there is no port {path}: `parfocal ports` lists those that there are")
            }
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
                format!("no permission to open {path}: install docs/99-parfocal.rules, or join the group `dialout`")
            }
            _ => format!("{path} cannot be opened: {}", e.description),
        };
        io::Error::other(text)
    })?;
    port.set_exclusive(true).ok();
    // A board behind USB wants to see a terminal ready; pseudo-terminals refuse, which is no fault.
    port.write_data_terminal_ready(true).ok();
    Ok(Box::new(port))
}

impl Transport for Serial {
    fn name(&self) -> String {
        self.path.clone()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        loop {
            let port = self.port.as_mut().ok_or(io::ErrorKind::NotConnected)?;
            match port.read(buffer) {
                // End of file: the device went away.
                Ok(0) => break,
                Ok(n) => return Ok(n),
                Err(e) if matches!(e.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {
                    if self.now() >= deadline {
                        return Ok(0);
                    }
                }
                Err(_) => break,
            }
        }
        self.port = None;
        Err(io::ErrorKind::NotConnected.into())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let port = self.port.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        match port.write_all(bytes) {
            // A full buffer: the far end does not read. What is lost is asked for again.
            Err(e) if e.kind() == io::ErrorKind::TimedOut => Ok(()),
            Err(_) => {
                self.port = None;
                Err(io::ErrorKind::NotConnected.into())
            }
            Ok(()) => Ok(()),
        }
    }

    fn now(&self) -> HostTime {
        real_now()
    }

    fn reconnect(&mut self) -> io::Result<()> {
        self.port = None;
        self.port = Some(open(&self.path)?);
        Ok(())
    }
}

/// A port on which a board may be.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct PortInfo {
    /// What to give to `--port`.
    pub name: String,
    /// What the system says of it.
    pub description: String,
    /// Whether its USB identity is a Parfocal board's or its debugger's.
    pub likely: bool,
}

/// The serial ports of this computer, likely boards first.
///
/// # Errors
/// When the system will not list its ports.
pub fn ports() -> io::Result<Vec<PortInfo>> {
    let mut list: Vec<PortInfo> = serialport::available_ports()
        .map_err(|e| io::Error::other(format!("the ports of this computer cannot be listed: {}", e.description)))?
        .into_iter()
        .map(|p| match p.port_type {
            SerialPortType::UsbPort(usb) => PortInfo {
                name: p.port_name,
                description: [usb.manufacturer, usb.product, usb.serial_number]
                    .into_iter()
                    .flatten()
                    .collect::<Vec<_>>()
                    .join(" "),
                likely: matches!((usb.vid, usb.pid), USB_IDENTITY | ST_LINK_V2_1),
            },
            _ => PortInfo { name: p.port_name, description: String::new(), likely: false },
        })
        .collect();
    list.sort_by_key(|p| (!p.likely, p.name.clone()));
    Ok(list)
}

/// The board's own USB port: pid.codes' test identity, until the project has one of its own.
pub const USB_IDENTITY: (u16, u16) = (0x1209, 0x0001);

/// The debugger on a Nucleo board, whose virtual port carries the same protocol.
const ST_LINK_V2_1: (u16, u16) = (0x0483, 0x374b);
