//! Frames on their way to the controller.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::ops::RangeInclusive;
use std::time::Duration;

use super::exposing::Settings;
use super::gvsp::Image;
use super::memory::{self, Memory};
use super::{Shared, State, TICK, pixels};
use mock_devices::failing::due;

/// So many frames can be sent once more.
const KEPT: usize = 4;

/// So many bytes are sent without a pause.
const BURST: usize = 64 * 1024;

/// Where the stream stands.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    runs: bool,
    /// How many acquisitions were started: what is exposed in one is not sent in the next.
    acquisitions: u32,
    triggers: u32,
    block: u16,
    /// Frames whose packets can be sent again, by number.
    kept: VecDeque<(u16, Vec<Vec<u8>>)>,
}

impl Streaming {
    pub(super) fn start(&mut self) {
        *self = Self {
            runs: true,
            acquisitions: self.acquisitions + 1,
            ..Self::default()
        };
    }

    pub(super) fn stop(&mut self) {
        self.runs = false;
        self.triggers = 0;
    }

    pub(super) fn runs(&self) -> bool {
        self.runs
    }

    /// A trigger during a frame is lost, as on real cameras; before it, it waits.
    pub(super) fn trigger(&mut self) {
        if self.runs {
            self.triggers = 1;
        }
    }

    fn next_block(&mut self) -> u16 {
        // 0 is no frame.
        self.block = self.block.checked_add(1).unwrap_or(1);
        self.block
    }
}

/// Where the controller wants the stream, as its registers say.
pub(super) fn destination(memory: &Memory) -> Option<SocketAddr> {
    let port = memory.get(memory::STREAM_PORT) as u16;
    let address = Ipv4Addr::from(memory.get(memory::STREAM_ADDRESS));
    (port != 0).then(|| SocketAddr::from((address, port)))
}

impl Shared {
    /// Takes and sends frames until the device ends.
    pub(super) fn stream(&self, socket: &UdpSocket) {
        let mut before: Option<Image> = None;
        loop {
            // Until a frame is due.
            let mut state = self.lock();
            let is_triggered = loop {
                if state.ends {
                    return;
                }
                let by_trigger = state.memory.get(memory::TRIGGER_MODE) == 1;
                let is_due = !by_trigger || state.streaming.triggers > 0;
                if state.streaming.runs && is_due {
                    state.streaming.triggers = 0;
                    break by_trigger;
                }
                let waited = self.changed.wait_timeout(state, TICK);
                state = waited.unwrap_or_else(std::sync::PoisonError::into_inner).0;
            };
            let exposure_us = self.faults.now().stuck_exposure_us;
            let settings = Settings {
                exposure_s: exposure_us.unwrap_or(state.memory.float(memory::EXPOSURE)) * 1e-6,
                gain: 10_f64.powf(state.memory.float(memory::GAIN) / 20.0),
                black_dn: state.memory.float(memory::BLACK_LEVEL),
            };
            let format = pixels::of_code(state.memory.get(memory::PIXEL_FORMAT));
            let size_px = [memory::WIDTH, memory::HEIGHT].map(|at| state.memory.get(at));
            let acquisition = state.streaming.acquisitions;
            drop(state);
            // The frame, and what happens to it.
            let (timestamp, counts) = self.exposer.expose(settings);
            let Some(format) = format else { continue };
            let format = match due(&mut self.faults.now().other_format) {
                true => pixels::FORMATS[0],
                false => format,
            };
            let mut image = Image {
                block: 0,
                timestamp,
                pixel_format: format.code,
                size_px,
                bytes: format.encode(&counts, self.exposer.bit_depth()),
            };
            if due(&mut self.faults.now().halved) {
                image.size_px[1] /= 2;
                let pixels = image.size_px[0] as usize * image.size_px[1] as usize;
                image.bytes.truncate(format.bytes(pixels));
            }
            if let Some(before) = &before
                && due(&mut self.faults.now().late)
            {
                image = before.clone();
            }
            // To the controller, if there still is one.
            let mut state = self.lock();
            let is_wanted = state.streaming.runs && state.streaming.acquisitions == acquisition;
            if is_wanted && !self.faults.now().is_gone {
                image.block = state.streaming.next_block();
                let delay = self.faults.now().delay.take();
                if let Some(delay) = delay {
                    drop(state);
                    std::thread::sleep(delay);
                    state = self.lock();
                }
                self.send(&mut state, socket, &image);
            }
            drop(state);
            before = Some(image);
            if !is_triggered {
                self.exposer.wait_for_interval(timestamp);
            }
        }
    }

    fn send(&self, state: &mut State, socket: &UdpSocket, image: &Image) {
        let Some(to) = destination(&state.memory) else {
            return;
        };
        if due(&mut self.faults.now().silent) {
            return;
        }
        let packet_bytes = state.memory.get(memory::PACKET_SIZE) & 0xffff;
        let packets = image.packets(packet_bytes as usize);
        self.send_all(socket, to, &packets);
        state.streaming.kept.push_back((image.block, packets));
        if state.streaming.kept.len() > KEPT {
            state.streaming.kept.pop_front();
        }
    }

    fn send_all(&self, socket: &UdpSocket, to: SocketAddr, packets: &[Vec<u8>]) {
        let mut sent = 0;
        for packet in packets {
            if !self.faults.now().loses_packet() {
                // As on a network, a packet may be lost.
                let _ = socket.send_to(packet, to);
            }
            // The receiver's buffer is finite.
            sent += packet.len();
            if sent > BURST {
                sent = 0;
                std::thread::sleep(Duration::from_micros(100));
            }
        }
    }

    /// Sends packets of a frame once more, as far as it still has them.
    pub(super) fn resend(
        &self,
        state: &mut State,
        socket: &UdpSocket,
        block: u16,
        numbers: RangeInclusive<u32>,
    ) {
        let kept = &state.streaming.kept;
        let frame = kept.iter().find(|(kept, _)| *kept == block);
        if let (Some((_, packets)), Some(to)) = (frame, destination(&state.memory)) {
            let last = (packets.len() - 1).min(*numbers.end() as usize);
            let first = *numbers.start() as usize;
            if first <= last {
                self.send_all(socket, to, &packets[first..=last]);
            }
        }
    }
}
