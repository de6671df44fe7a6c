//! The guardian's own side: it waits, and stops the stage when it must.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::termios::{QueueSelector, tcflush};

use super::message::{self, Message, PONG};
use super::{DEADLINE, Exchange, GRACE};

/// An answer that takes longer is not waited for; everything is sent again.
const PATIENCE: Duration = Duration::from_millis(700);

/// How a guardian's watch ended.
#[derive(Debug)]
pub enum Watch {
    /// It was dismissed and has done nothing.
    Dismissed,
    /// The socket was closed without a dismissal; whether the stage confirmed that
    /// it has stopped.
    Acted(io::Result<()>),
    /// The program that was relieved has ended, too.
    Relieved,
}

/// Waits at the socket. When that is closed without a dismissal, stops the stage.
/// When the next sign of life is overdue, relieves the program: it marks the
/// socket, stops the stage, tells `relieved` whether the stage has confirmed it,
/// and stays until the program has ended.
pub fn stand_guard(
    link: UnixStream,
    port: OwnedFd,
    exchanges: &[Exchange],
    relieved: &mut dyn FnMut(io::Result<()>),
) -> Watch {
    let port = File::from(port);
    let mut until = None;
    let mut has_acted = false;
    loop {
        let overdue = until
            .filter(|_| !has_acted)
            .map(|until: Duration| until + GRACE);
        match next(&link, overdue) {
            Heard::Message(Message::Until(time)) => until = Some(time),
            Heard::Message(Message::Rest) => until = None,
            // Where nobody takes the answer, the socket is closed.
            Heard::Message(Message::Ping) => drop((&link).write(&[PONG])),
            Heard::Message(Message::Dismissed) if !has_acted => return Watch::Dismissed,
            Heard::Message(Message::Again) if has_acted => drop(stop(&port, exchanges)),
            Heard::Message(Message::Dismissed | Message::Again) => {}
            Heard::Nothing => {
                has_acted = true;
                // Before anything is sent: whoever wakes now shall send nothing.
                drop(link.shutdown(Shutdown::Write));
                relieved(stop(&port, exchanges));
            }
            Heard::End if has_acted => {
                drop(stop(&port, exchanges));
                return Watch::Relieved;
            }
            Heard::End => return Watch::Acted(stop(&port, exchanges)),
        }
    }
}

enum Heard {
    Message(Message),
    /// Until it was overdue.
    Nothing,
    /// The socket is closed, or says what no program of this version would.
    End,
}

fn next(link: &UnixStream, overdue: Option<Duration>) -> Heard {
    if let Some(overdue) = overdue {
        let left = overdue.saturating_sub(message::now());
        match is_ready(link, PollFlags::IN, Instant::now() + left) {
            Ok(true) => {}
            Ok(false) => return Heard::Nothing,
            Err(_) => return Heard::End,
        }
    }
    let mut bytes = [0; message::LENGTH];
    match (&mut &*link).read_exact(&mut bytes) {
        Ok(()) => Message::from_bytes(bytes).map_or(Heard::End, Heard::Message),
        Err(_) => Heard::End,
    }
}

fn stop(port: &File, exchanges: &[Exchange]) -> io::Result<()> {
    let end = Instant::now() + DEADLINE;
    // The program, where it wakes, may take what this one was about to read: neither
    // shall wait for it. Both have the same open port, so this holds for both.
    fcntl_setfl(port, fcntl_getfl(port)? | OFlags::NONBLOCK)?;
    // What waits to be sent would come before the stop; not every port can.
    let _ = tcflush(port, QueueSelector::OFlush);
    while Instant::now() < end {
        let mut confirmed = true;
        for exchange in exchanges {
            confirmed &= perform(port, exchange, end)?;
        }
        if confirmed {
            return Ok(());
        }
    }
    Err(io::Error::new(
        io::ErrorKind::TimedOut,
        format!("no confirmation within {} s", DEADLINE.as_secs()),
    ))
}

/// Whether the device gave one of the answers in time.
fn perform(mut port: &File, exchange: &Exchange, end: Instant) -> io::Result<bool> {
    let until = end.min(Instant::now() + PATIENCE);
    let mut heard = Vec::new();
    let mut buffer = [0; 256];
    // What was said before is no answer.
    while is_ready(port, PollFlags::IN, Instant::now())? && read(port, &mut buffer)? != Some(0) {}
    if !is_ready(port, PollFlags::OUT, until)? {
        return Ok(false);
    }
    match port.write_all(&exchange.send) {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
        written => written?,
    }
    loop {
        let mut answers = exchange.answers.iter();
        if exchange.answers.is_empty()
            || answers.any(|answer| heard.windows(answer.len()).any(|part| part == answer))
        {
            return Ok(true);
        }
        if !is_ready(port, PollFlags::IN, until)? {
            return Ok(false);
        }
        match read(port, &mut buffer)? {
            Some(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Some(count) => heard.extend_from_slice(&buffer[..count]),
            None => {}
        }
    }
}

/// How many bytes were read, 0 where the port is gone; none if somebody else took them
/// after they were announced.
fn read(mut port: &File, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    match port.read(buffer) {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
        read => read.map(Some),
    }
}

fn is_ready(port: &impl AsFd, event: PollFlags, until: Instant) -> io::Result<bool> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        let timeout = Timespec {
            tv_sec: left.as_secs() as i64,
            tv_nsec: i64::from(left.subsec_nanos()),
        };
        let mut descriptors = [PollFd::new(port, event)];
        match poll(&mut descriptors, Some(&timeout)) {
            Ok(0) => return Ok(false),
            Ok(_) if descriptors[0].revents().contains(event) => return Ok(true),
            Ok(_) => return Err(io::ErrorKind::BrokenPipe.into()),
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::exchanges;
    use super::*;

    /// The program's end of the socket, which says this.
    fn program(messages: &[Message]) -> (UnixStream, UnixStream) {
        let (mut program, link) = UnixStream::pair().unwrap();
        for message in messages {
            program.write_all(&message.to_bytes()).unwrap();
        }
        (program, link)
    }

    /// What the device received, and how the watch ended. `answer` is the device's
    /// to each byte.
    fn watch(messages: &[Message], answer: fn(u8) -> &'static [u8]) -> (Vec<u8>, Watch) {
        let (port, mut device) = UnixStream::pair().unwrap();
        // Said long before.
        device.write_all(b"Grbl <Idle").unwrap();
        let device = std::thread::spawn(move || {
            let mut heard = Vec::new();
            let mut byte = [0];
            // An end with bytes unread is an error to this one.
            while matches!(device.read(&mut byte), Ok(1)) {
                heard.push(byte[0]);
                if device.write_all(answer(byte[0])).is_err() {
                    break;
                }
            }
            heard
        });
        let (program, link) = program(messages);
        drop(program);
        let watch = stand_guard(link, port.into(), &exchanges(), &mut |_| {});
        (device.join().unwrap(), watch)
    }

    #[test]
    fn a_dismissed_guardian_does_nothing() {
        let (heard, watch) = watch(&[Message::Ping, Message::Dismissed], |_| b"");
        assert!(matches!(watch, Watch::Dismissed) && heard.is_empty());
    }

    #[test]
    fn a_closed_socket_stops_the_stage_once_it_confirms() {
        let (heard, watch) = watch(&[], |byte| match byte {
            0x18 => b"\r\nGrbl 1.1h ['$' for help]\r\n",
            b'?' => b"<Alarm|MPos:0.000,0.000,0.000>\r\n",
            _ => b"",
        });
        assert!(matches!(watch, Watch::Acted(Ok(()))), "{watch:?}");
        assert_eq!(heard, [b'!', 0x18, b'?']);
    }

    #[test]
    fn a_stage_that_does_not_confirm_is_asked_again_and_told() {
        let began = Instant::now();
        let (heard, watch) = watch(&[], |byte| match byte {
            0x18 => b"Grbl",
            _ => b"<Run|",
        });
        assert!(matches!(watch, Watch::Acted(Err(_))), "{watch:?}");
        assert!(heard.len() > 3 && began.elapsed() >= DEADLINE, "{heard:?}");
    }

    /// The program may wake and read the answer that the guardian has seen coming: that
    /// ends in time, too.
    #[test]
    fn an_answer_that_somebody_else_takes_is_not_waited_for() {
        let (port, mut device) = UnixStream::pair().unwrap();
        let thief = port.try_clone().unwrap();
        let taken = std::thread::spawn(move || {
            let mut buffer = [0; 64];
            let mut taken = 0;
            loop {
                match (&thief).read(&mut buffer) {
                    Ok(0) => return taken,
                    Ok(count) => taken += count,
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Err(_) => return taken,
                }
            }
        });
        let answering = std::thread::spawn(move || {
            let mut byte = [0];
            while matches!(device.read(&mut byte), Ok(1)) {
                for said in [b"<Run".as_slice(), b"|MPos", b">\r\n"] {
                    std::thread::sleep(Duration::from_micros(50));
                    drop(device.write_all(said));
                }
            }
        });
        let (program, link) = program(&[]);
        drop(program);
        let (ended, ends) = std::sync::mpsc::channel();
        let shut = port.try_clone().unwrap();
        std::thread::spawn(move || {
            let watch = stand_guard(link, port.into(), &exchanges(), &mut |_| {});
            ended.send(watch).unwrap();
        });
        let watch = ends.recv_timeout(3 * DEADLINE).expect("it does not end");
        assert!(matches!(watch, Watch::Acted(_)), "{watch:?}");
        shut.shutdown(Shutdown::Both).unwrap();
        assert!(taken.join().unwrap() > 0);
        answering.join().unwrap();
    }

    /// A program that says nothing for longer than it announced is relieved, one
    /// that rests is not, and what it still sends is undone.
    #[test]
    fn an_overdue_sign_of_life_relieves_the_program() {
        let (port, mut device) = UnixStream::pair().unwrap();
        let (mut program, link) = program(&[
            Message::Until(message::now()),
            Message::Rest,
            Message::Until(message::now() + Duration::from_millis(200)),
        ]);
        let answering = std::thread::spawn(move || {
            let mut resets = 0;
            let mut byte = [0];
            while matches!(device.read(&mut byte), Ok(1)) {
                resets += u32::from(byte[0] == 0x18);
                drop(device.write_all(b"Grbl <Idle|"));
            }
            resets
        });
        let (told, hears) = std::sync::mpsc::channel();
        let guard = std::thread::spawn(move || {
            stand_guard(link, port.into(), &exchanges(), &mut |outcome| {
                told.send(outcome.is_ok()).unwrap();
            })
        });
        // It reads the mark as the end of what the guardian says.
        assert_eq!(program.read(&mut [0; 8]).unwrap(), 0);
        assert!(hears.recv().unwrap());
        program.write_all(&Message::Again.to_bytes()).unwrap();
        drop(program);
        assert!(matches!(guard.join().unwrap(), Watch::Relieved));
        assert!(answering.join().unwrap() >= 3);
    }
}
