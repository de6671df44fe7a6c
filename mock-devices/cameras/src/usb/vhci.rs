//! The cable: a device on a port of the virtual host controller.

use std::collections::VecDeque;
use std::fs;
use std::io::{self, Read, Write};
use std::net::Shutdown;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread::JoinHandle;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::{Setup, Stall, UsbDevice};

/// Where the controller is.
const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
/// A port to which nothing is attached, in its `status`.
const FREE: &str = "004";
/// USB_SPEED_HIGH.
const HIGH_SPEED: u32 = 3;

/// Commands and answers of USB/IP; a header has 48 bytes, numbers of 32 bits,
/// big-endian.
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const SUBMITTED: u32 = 3;
const UNLINKED: u32 = 4;
const HEADER: usize = 48;
/// EPIPE and ECONNRESET, as the kernel says them.
const STALLED: i32 = -32;
const CANCELLED: i32 = -104;
/// The kernel never requests more at once.
const MOST_BYTES: usize = 1 << 20;
/// How often a device with nothing to say is asked again.
const ASK_AGAIN_MS: i64 = 1;

/// A device that is plugged in; dropping it pulls it out.
#[derive(Debug)]
pub struct Plugged {
    socket: UnixStream,
    thread: Option<JoinHandle<()>>,
}

impl Plugged {
    /// Plugs the device into a free port.
    pub fn into_free_port(device: impl UsbDevice) -> io::Result<Self> {
        let controller = Path::new(CONTROLLER);
        let status = fs::read_to_string(controller.join("status"))?;
        let port = free_port(&status).ok_or_else(|| io::Error::other("no port is free"))?;
        let (socket, kernels) = UnixStream::pair()?;
        let number = (1 << 16) | (port + 2);
        let attach = format!("{port} {} {number} {HIGH_SPEED}", kernels.as_raw_fd());
        let served = socket.try_clone()?;
        fs::write(controller.join("attach"), attach)?;
        let thread = std::thread::Builder::new()
            .name("usb-device".to_owned())
            .spawn(move || {
                // It ends with an error when it is pulled out.
                let _ = Cable::new(served, device).serve();
            })?;
        Ok(Self {
            socket,
            thread: Some(thread),
        })
    }
}

impl Drop for Plugged {
    fn drop(&mut self) {
        let _ = self.socket.shutdown(Shutdown::Both);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// From lines such as `hs  0000 004 000 00000000 000000 0-0`.
fn free_port(status: &str) -> Option<u32> {
    status.lines().find_map(|line| {
        let mut words = line.split_whitespace();
        let (hub, port, state) = (words.next()?, words.next()?, words.next()?);
        (hub == "hs" && state == FREE).then(|| port.parse().ok())?
    })
}

/// A transfer to the host that waits for the device.
struct Waiting {
    number: u32,
    endpoint: u8,
    most: usize,
}

struct Cable<D> {
    socket: UnixStream,
    device: D,
    waiting: VecDeque<Waiting>,
}

impl<D: UsbDevice> Cable<D> {
    fn new(socket: UnixStream, device: D) -> Self {
        Self {
            socket,
            device,
            waiting: VecDeque::new(),
        }
    }

    fn serve(mut self) -> io::Result<()> {
        loop {
            let timeout = Timespec {
                tv_sec: 0,
                tv_nsec: ASK_AGAIN_MS * 1_000_000,
            };
            let patience = (!self.waiting.is_empty()).then_some(&timeout);
            let mut ready = [PollFd::new(&self.socket, PollFlags::IN)];
            if poll(&mut ready, patience)? > 0 {
                self.read_command()?;
            }
            self.feed()?;
        }
    }

    fn read_command(&mut self) -> io::Result<()> {
        let mut header = [0; HEADER];
        self.socket.read_exact(&mut header)?;
        let word = |at: usize| {
            let bytes = &header[4 * at..4 * at + 4];
            u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
        };
        let (number, to_host, endpoint) = (word(1), word(3) == 1, word(4) as u8);
        match word(0) {
            SUBMIT => {
                let length = (word(6) as usize).min(MOST_BYTES);
                let mut data = vec![0; if to_host { 0 } else { length }];
                self.socket.read_exact(&mut data)?;
                if endpoint == 0 {
                    let mut setup = [0; 8];
                    setup.copy_from_slice(&header[40..48]);
                    self.control(number, Setup::parse(&setup), &data)
                } else if to_host {
                    self.waiting.push_back(Waiting {
                        number,
                        endpoint,
                        most: length,
                    });
                    Ok(())
                } else {
                    self.device.take(endpoint, &data);
                    self.answer(SUBMITTED, number, 0, data.len(), &[])
                }
            }
            UNLINK => {
                let cancelled = word(5);
                let before = self.waiting.len();
                self.waiting.retain(|transfer| transfer.number != cancelled);
                let status = if self.waiting.len() < before {
                    CANCELLED
                } else {
                    0
                };
                self.answer(UNLINKED, number, status, 0, &[])
            }
            other => Err(io::Error::other(format!("command {other} is unknown"))),
        }
    }

    fn control(&mut self, number: u32, setup: Setup, data: &[u8]) -> io::Result<()> {
        let is_standard = setup.request_type & 0x60 == 0;
        let answer = if is_standard {
            self.device.descriptors().answer(setup)
        } else {
            self.device.control(setup, data)
        };
        match answer {
            Ok(mut bytes) if setup.request_type & 0x80 != 0 => {
                bytes.truncate(usize::from(setup.length));
                self.answer(SUBMITTED, number, 0, bytes.len(), &bytes)
            }
            Ok(_) => self.answer(SUBMITTED, number, 0, data.len(), &[]),
            Err(Stall) => self.answer(SUBMITTED, number, STALLED, 0, &[]),
        }
    }

    /// Transfers of one endpoint are answered in their order.
    fn feed(&mut self) -> io::Result<()> {
        let mut silent = Vec::new();
        for transfer in std::mem::take(&mut self.waiting) {
            let bytes = if silent.contains(&transfer.endpoint) {
                None
            } else {
                self.device.give(transfer.endpoint, transfer.most)
            };
            match bytes {
                Some(bytes) => self.answer(SUBMITTED, transfer.number, 0, bytes.len(), &bytes)?,
                None => {
                    silent.push(transfer.endpoint);
                    self.waiting.push_back(transfer);
                }
            }
        }
        Ok(())
    }

    fn answer(
        &mut self,
        kind: u32,
        number: u32,
        status: i32,
        length: usize,
        data: &[u8],
    ) -> io::Result<()> {
        let mut header = [0; HEADER];
        let words = [kind, number, 0, 0, 0, status as u32, length as u32];
        for (place, word) in header.chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_be_bytes());
        }
        self.socket.write_all(&header)?;
        self.socket.write_all(data)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Descriptors;
    use super::super::descriptors::Identity;
    use super::*;

    /// Gives back what it was given.
    struct Echo(Descriptors, Vec<u8>);

    impl UsbDevice for Echo {
        fn descriptors(&self) -> &Descriptors {
            &self.0
        }
        fn control(&mut self, setup: Setup, _: &[u8]) -> Result<Vec<u8>, Stall> {
            match setup.request {
                7 => Ok(vec![1, 2, 3, 4]),
                _ => Err(Stall),
            }
        }
        fn take(&mut self, _: u8, data: &[u8]) {
            self.1.extend(data);
        }
        fn give(&mut self, _: u8, most: usize) -> Option<Vec<u8>> {
            let most = most.min(self.1.len());
            (most > 0).then(|| self.1.drain(..most).collect())
        }
    }

    fn ask(host: &mut UnixStream, words: [u32; 10], setup: [u8; 8], data: &[u8]) {
        let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
        bytes.extend(setup);
        bytes.extend(data);
        host.write_all(&bytes).unwrap();
    }

    /// Kind, number, status and data.
    fn answer(host: &mut UnixStream, has_data: bool) -> (u32, u32, i32, Vec<u8>) {
        let mut header = [0; HEADER];
        host.read_exact(&mut header).unwrap();
        let word = |at: usize| u32::from_be_bytes(header[4 * at..4 * at + 4].try_into().unwrap());
        let mut data = vec![0; if has_data { word(6) as usize } else { 0 }];
        host.read_exact(&mut data).unwrap();
        (word(0), word(1), word(5) as i32, data)
    }

    #[test]
    fn transfers_wait_and_are_cancelled_and_requests_stall() {
        let (mut host, device) = UnixStream::pair().unwrap();
        let echo = Echo(
            Descriptors::new(Identity::gadget(1), ["", "", ""], &[]),
            Vec::new(),
        );
        let served = std::thread::spawn(|| Cable::new(device, echo).serve().is_err());
        let submit = |number, to_host, endpoint, length| {
            [SUBMIT, number, 0, to_host, endpoint, 0, length, 0, 0, 0]
        };
        // Two requests of the class: the first is cut to what was requested.
        ask(
            &mut host,
            submit(1, 1, 0, 3),
            [0xc0, 7, 0, 0, 0, 0, 3, 0],
            &[],
        );
        assert_eq!(answer(&mut host, true), (SUBMITTED, 1, 0, vec![1, 2, 3]));
        ask(
            &mut host,
            submit(2, 1, 0, 3),
            [0xc0, 8, 0, 0, 0, 0, 3, 0],
            &[],
        );
        assert_eq!(answer(&mut host, true), (SUBMITTED, 2, STALLED, vec![]));
        // Of two that wait one is cancelled, the other gets the bytes.
        ask(&mut host, submit(3, 1, 1, 8), [0; 8], &[]);
        ask(&mut host, submit(4, 1, 1, 8), [0; 8], &[]);
        ask(&mut host, [UNLINK, 5, 0, 0, 0, 3, 0, 0, 0, 0], [0; 8], &[]);
        assert_eq!(answer(&mut host, false), (UNLINKED, 5, CANCELLED, vec![]));
        ask(&mut host, submit(6, 0, 1, 2), [0; 8], b"hi");
        assert_eq!(answer(&mut host, false), (SUBMITTED, 6, 0, vec![]));
        assert_eq!(answer(&mut host, true), (SUBMITTED, 4, 0, b"hi".to_vec()));
        drop(host);
        assert!(served.join().unwrap());
    }

    #[test]
    fn a_free_port_is_found() {
        let status = "hub port sta spd dev      sockfd local_busid\n\
                      hs  0000 006 003 00010002 000003 1-1\n\
                      hs  0001 004 000 00000000 000000 0-0\n\
                      ss  0008 004 000 00000000 000000 0-0\n";
        assert_eq!(free_port(status), Some(1));
        assert_eq!(free_port("hub port sta\nss  0008 004 000\n"), None);
    }
}
