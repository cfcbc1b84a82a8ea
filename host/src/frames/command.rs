//! A camera behind another program: its frames come as YUV4MPEG2 from the program's standard output.
//!
//! `exec:ffmpeg -f v4l2 -i /dev/video0 -pix_fmt gray -f yuv4mpegpipe -` and everything else that a shell can run. A thread
//! reads as fast as the program writes, so that no old frames wait in the pipe; who comes late misses frames.

use super::camera::{Camera, CameraError, Frame};
use super::mailbox::{Mailbox, Outlet};
use super::y4m::{Stream, Y4mError};
use crate::link::transport::real_now;
use parfocal_protocol::units::HostTime;
use std::io::{BufReader, Read};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Programs may take this long to open a camera.
const START: Duration = Duration::from_secs(8);
/// As much as is kept of what the program complained last.
const SAID: usize = 2000;

/// A running program that delivers frames. Dropping it ends the program.
pub struct CommandCamera {
    child: Child,
    outlet: Outlet,
}

impl CommandCamera {
    /// Starts a command line in the system's shell. `latency` is the longest time from the begin of an exposure to its
    /// frame's arrival; without it the frames have no exposure times.
    ///
    /// # Errors
    /// When there is no shell to run it. A command that cannot run is told by the first frame asked for.
    pub fn start(command: &str, latency: Option<Duration>) -> Result<Self, CameraError> {
        let name = shown(command);
        let cannot =
            |e| CameraError::Unopened { camera: name.clone(), reason: format!("the shell cannot be started: {e}") };
        let mut shell = Command::new(if cfg!(windows) { "cmd" } else { "sh" });
        shell.args([if cfg!(windows) { "/C" } else { "-c" }, command]);
        shell.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // A group of its own: Ctrl-C is for this program to handle, and the end reaches every part of a pipeline.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut shell, 0);
        let mut child = shell.spawn().map_err(cannot)?;
        let mailbox = Mailbox::default();
        let outlet = Outlet::new(name, mailbox.clone(), START);
        let said = Arc::<Mutex<String>>::default();
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let complaints = stderr.map(|stderr| {
            let said = said.clone();
            std::thread::spawn(move || listen(stderr, &said))
        });
        if let Some(stdout) = stdout {
            let mailbox = mailbox.clone();
            std::thread::spawn(move || {
                let reason = read(BufReader::with_capacity(1 << 20, stdout), &mailbox, latency);
                // What it complained about comes before the end is told, unless a part of it lives on silently.
                for _ in 0..20 {
                    if complaints.as_ref().is_none_or(|thread| thread.is_finished()) {
                        break;
                    }
                    std::thread::sleep(Duration::from_millis(10));
                }
                let said = said.lock().unwrap_or_else(PoisonError::into_inner).clone();
                let last = said.trim().lines().rev().take(3).collect::<Vec<_>>();
                let said = last.into_iter().rev().collect::<Vec<_>>().join(" / ");
                mailbox.end(if said.is_empty() { reason } else { format!("{reason}; it said: {said}") });
            });
        }
        Ok(Self { child, outlet })
    }
}

/// Reads frames until none come any more, and says why.
fn read(stdout: impl std::io::BufRead, mailbox: &Mailbox, latency: Option<Duration>) -> String {
    let mut stream = match Stream::new(stdout) {
        Ok(stream) => stream,
        Err(Y4mError::NotY4m) => return Y4mError::NotY4m.to_string(),
        Err(error) => return error.to_string(),
    };
    let mut number = 0;
    loop {
        match stream.frame() {
            Ok(Some(picture)) => {
                let arrival = real_now();
                let begin = latency.map(|l| HostTime(arrival.0.saturating_sub(l.as_micros() as u64)));
                let frame = Frame { picture: picture.into(), number, exposure: begin.map(|b| (b, b)), arrival };
                mailbox.put(frame);
                number += 1;
            }
            Ok(None) => return "the program ended its output".into(),
            Err(error) => return error.to_string(),
        }
    }
}

/// Keeps the last of what a program complains, and never lets it wait for a reader.
fn listen(mut stderr: ChildStderr, said: &Mutex<String>) {
    let mut buffer = [0; 1024];
    while let Ok(n) = stderr.read(&mut buffer) {
        if n == 0 {
            break;
        }
        let text = String::from_utf8_lossy(&buffer[..n]).replace('\r', "\n");
        // Whole at any time.
        let mut said = said.lock().unwrap_or_else(PoisonError::into_inner);
        said.push_str(&text);
        let mut cut = said.len().saturating_sub(SAID);
        while !said.is_char_boundary(cut) {
            cut += 1;
        }
        said.drain(..cut);
    }
}

/// A command in messages: its beginning.
fn shown(command: &str) -> String {
    let mut text: String = command.chars().take(60).collect();
    if text.len() < command.len() {
        text.push('…');
    }
    format!("'{text}'")
}

impl Camera for CommandCamera {
    fn name(&self) -> String {
        self.outlet.name()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        self.outlet.next_frame(deadline)
    }
}

impl Drop for CommandCamera {
    fn drop(&mut self) {
        #[cfg(unix)]
        if let Some(group) = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::link::transport::later;

    /// `count` frames of a size, written by the shell.
    fn frames(width: usize, height: usize, count: usize) -> String {
        let body = "x".repeat(width * height);
        format!(
            "echo 'YUV4MPEG2 W{width} H{height} F30:1 Cmono'; for i in $(seq {count}); do printf 'FRAME\\n{body}'; done"
        )
    }

    fn next(camera: &mut CommandCamera) -> Result<Option<Frame>, CameraError> {
        camera.next_frame(later(real_now(), 4000))
    }

    #[test]
    fn frames_come_in_order_with_their_latency_until_the_program_ends() {
        let latency = Some(Duration::from_millis(40));
        let mut camera = CommandCamera::start(&format!("{}; exit 3", frames(4, 2, 3)), latency).unwrap();
        for number in 0..3 {
            let frame = next(&mut camera).unwrap().unwrap();
            assert_eq!((frame.number, frame.picture.width), (number, 4));
            assert_eq!(frame.exposure.unwrap().0.0 + 40_000, frame.arrival.0.max(40_000));
        }
        assert!(
            matches!(next(&mut camera), Err(CameraError::Ended { reason, .. }) if reason.contains("ended its output"))
        );
    }

    #[test]
    fn a_program_that_dies_is_told_with_its_last_words() {
        let mut camera = CommandCamera::start("echo no such device >&2; exit 1", None).unwrap();
        let said = next(&mut camera).unwrap_err().to_string();
        assert!(said.contains("no such device"), "{said}");
        let mut camera = CommandCamera::start("echo hello", None).unwrap();
        let said = next(&mut camera).unwrap_err().to_string();
        assert!(said.contains("YUV4MPEG2"), "{said}");
    }

    #[test]
    fn a_program_that_stalls_is_told_and_ended() {
        let mut camera = CommandCamera::start(&format!("{}; sleep 60 | cat", frames(2, 2, 1)), None).unwrap();
        assert!(next(&mut camera).unwrap().is_some());
        assert!(matches!(next(&mut camera), Err(CameraError::Stalled { millis, .. }) if millis >= 1500));
        let group = camera.child.id();
        drop(camera);
        // Killed, whether whoever inherits them has buried them or not.
        let lives = |line: &&str| {
            let mut words = line.split_whitespace();
            words.next() == Some(&group.to_string()) && words.next().is_some_and(|state| !state.starts_with('Z'))
        };
        let living = || {
            let all = Command::new("ps").args(["-eo", "pgid=,stat=,args="]).output().ok()?;
            Some(String::from_utf8_lossy(&all.stdout).lines().filter(lives).map(String::from).collect::<Vec<_>>())
        };
        for _ in 0..100 {
            match living() {
                Some(left) if !left.is_empty() => std::thread::sleep(Duration::from_millis(20)),
                _ => return,
            }
        }
        panic!("the whole pipeline should end: {:?}", living());
    }

    #[test]
    fn frames_of_another_size_are_refused() {
        let mut camera = CommandCamera::start(&format!("{}; {}", frames(4, 2, 1), frames(2, 2, 1)), None).unwrap();
        assert!(next(&mut camera).unwrap().is_some());
        let said = next(&mut camera).unwrap_err().to_string();
        assert!(said.contains("from 4x2 to 2x2"), "{said}");
    }

    #[test]
    fn who_comes_late_gets_the_latest_frames() {
        let mut camera = CommandCamera::start(&format!("{}; sleep 60", frames(2, 2, 50)), None).unwrap();
        while camera.outlet.latest().is_none_or(|number| number < 49) {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(next(&mut camera).unwrap().unwrap().number, 46);
    }
}
