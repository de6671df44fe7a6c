//! A camera under this process' control: opened, its stream, its clock.

use std::time::{Duration, Instant};

use aravis::glib::object::Cast;
use aravis::{
    Buffer, CameraExt, CameraExtManual, DeviceError as Kind, GvDevice, GvStreamOption, Stream,
    StreamExt,
};

use super::features::Features;
use super::find;
use crate::device::DeviceError;

/// Buffers of the stream. Each frame is requested alone, so that one would do; the others
/// take what a camera sends without a request.
const BUFFERS: usize = 4;
/// Size of a packet on this machine's own loopback, bytes.
const LOOPBACK_PACKET: i32 = 9000;
/// Heartbeat time-out of a camera that does not state its own.
const HEARTBEAT: Duration = Duration::from_secs(3);
/// A camera whose heartbeat time-out is longer is not waited for any longer.
const LONGEST_WAIT: Duration = Duration::from_secs(8);

/// A camera that this process controls.
pub struct Link {
    /// First, because it is dropped first.
    stream: Option<Stream>,
    camera: aravis::Camera,
    /// Its features.
    pub features: Features,
    is_acquiring: bool,
    /// The size of packets is chosen.
    is_tuned: bool,
}

impl Link {
    /// Opens the camera of this name, serial number or address and takes control. Control
    /// that a process left behind when it was killed ends with the heartbeat time-out, which
    /// is waited for.
    ///
    /// # Errors
    /// It is not there, the system refuses it, or another program controls it.
    pub fn open(name: &str) -> Result<Self, DeviceError> {
        let camera = open_camera(name)?;
        let device = camera.device();
        let features = Features {
            device: device.ok_or_else(|| not_found(name))?,
            name: name.to_owned(),
        };
        if let Some(network) = features.device.downcast_ref::<GvDevice>() {
            let stated_ms = features.integer("GevHeartbeatTimeout").ok();
            let heartbeat = stated_ms.and_then(|ms| u64::try_from(ms).ok());
            let heartbeat = heartbeat.map_or(HEARTBEAT, Duration::from_millis);
            let until = Instant::now() + (heartbeat + Duration::from_secs(1)).min(LONGEST_WAIT);
            while !features.has_control() && network.take_control().is_err() {
                if Instant::now() > until {
                    let device = name.to_owned();
                    return Err(DeviceError::Controlled { device });
                }
                std::thread::sleep(Duration::from_millis(200));
            }
        }
        Ok(Self {
            stream: None,
            camera,
            features,
            is_acquiring: false,
            is_tuned: false,
        })
    }

    /// Lets frames be triggered; opens the stream where there is none.
    ///
    /// # Errors
    /// There is no stream, or the camera refuses.
    pub fn start(&mut self) -> Result<(), DeviceError> {
        if self.is_acquiring {
            return Ok(());
        }
        match &self.stream {
            Some(stream) => {
                // Numbers of frames begin anew, which only a new thread accepts.
                stream.stop_thread(false);
                drain(stream);
                stream.start_thread();
            }
            None => self.stream = Some(self.open_stream()?),
        }
        self.features.execute("AcquisitionStart")?;
        self.is_acquiring = true;
        Ok(())
    }

    /// Closes the stream, so that nothing that is still on its way, or is sent again, arrives
    /// in the next one.
    pub fn close_stream(&mut self) {
        self.stream = None;
    }

    /// Ends what is under way.
    ///
    /// # Errors
    /// The camera refuses.
    pub fn stop(&mut self) -> Result<(), DeviceError> {
        if self.is_acquiring {
            self.features.execute("AcquisitionStop")?;
            self.is_acquiring = false;
        }
        Ok(())
    }

    fn open_stream(&mut self) -> Result<Stream, DeviceError> {
        let features = &self.features;
        if let Some(network) = features.device.downcast_ref::<GvDevice>()
            && !self.is_tuned
        {
            // A raw socket needs rights that programs rarely have, and sees no packets of
            // the loopback device.
            network.set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
            let address = features.integer("GevCurrentIPAddress").unwrap_or(0);
            let tuned = match address >> 24 == 127 {
                true => network.set_packet_size(LOOPBACK_PACKET),
                false => network.auto_packet_size(),
            };
            // The size that it has stays.
            tuned.unwrap_or_else(|error| tracing::debug!("packet size: {error}"));
            self.is_tuned = true;
        }
        let stream = self.camera.create_stream();
        let stream = stream.map_err(|error| features.failed("a stream", &error))?;
        let bytes = features.integer("PayloadSize")?;
        for _ in 0..BUFFERS {
            stream.push_buffer(Buffer::new_allocate(bytes.max(1) as usize));
        }
        Ok(stream)
    }

    /// Triggers a frame and calls `read` with it; `None` where none has come by then.
    ///
    /// # Errors
    /// There is no stream, the camera refuses, or what `read` returns.
    pub fn take<T>(
        &self,
        deadline: Instant,
        read: impl FnOnce(&Buffer) -> Result<T, DeviceError>,
    ) -> Result<Option<T>, DeviceError> {
        let Some(stream) = &self.stream else {
            return Err(self.features.refused("a frame", "it is not configured"));
        };
        drain(stream);
        self.features.execute("TriggerSoftware")?;
        let left = deadline.saturating_duration_since(Instant::now());
        let left = left.max(Duration::from_millis(1));
        let Some(buffer) = stream.timeout_pop_buffer(left.as_micros() as u64) else {
            return Ok(None);
        };
        let result = read(&buffer);
        stream.push_buffer(buffer);
        result.map(Some)
    }

    /// The camera's clock now, ns, on which time stamps of frames are; `None` where it
    /// cannot be read.
    pub fn clock_ns(&self) -> Option<u64> {
        let features = &self.features;
        let read = |latch: &str, value: &str| {
            let is_there = features.has(latch) && features.has(value);
            let latched = is_there && features.execute(latch).is_ok();
            let read = latched.then(|| features.integer(value).ok()).flatten();
            read.and_then(|ticks| u64::try_from(ticks).ok())
        };
        if let Some(ns) = read("TimestampLatch", "TimestampLatchValue") {
            return Some(ns);
        }
        let ticks = read("GevTimestampControlLatch", "GevTimestampValue")?;
        let per_s = features.integer("GevTimestampTickFrequency").ok()?;
        (per_s > 0).then(|| (ticks as f64 * 1e9 / per_s as f64) as u64)
    }
}

fn drain(stream: &Stream) {
    while let Some(buffer) = stream.try_pop_buffer() {
        stream.push_buffer(buffer);
    }
}

fn not_found(name: &str) -> DeviceError {
    let device = name.to_owned();
    DeviceError::NotFound { device }
}

/// Opens by name or address, else by a serial number of the list.
fn open_camera(name: &str) -> Result<aravis::Camera, DeviceError> {
    let _lists = find::lists();
    let mut opened = aravis::Camera::new(Some(name));
    let mut listed = None;
    if opened.is_err() {
        let all = find::listed().into_iter();
        listed = all.into_iter().find(|camera| camera.is_called(name));
        if let Some(camera) = &listed
            && camera.id != name
        {
            opened = aravis::Camera::new(Some(&camera.id));
        }
    }
    opened.map_err(|error| {
        let device = name.to_owned();
        let address = listed.map_or(device.clone(), |camera| camera.address);
        let message = error.message();
        match error.kind::<Kind>() {
            _ if find::is_controlled(&address) => DeviceError::Controlled { device },
            // Aravis has no kind of its own for an interface that another program has.
            Some(Kind::ProtocolError) if message.contains("claim") => {
                DeviceError::Controlled { device }
            }
            Some(Kind::NotFound) | None => match find::usb_without_permission(name) {
                Some(node) => DeviceError::PermissionDenied { device: node },
                None => DeviceError::NotFound { device },
            },
            Some(_) => DeviceError::Refused {
                device,
                command: "to be opened".to_owned(),
                reason: message.to_owned(),
            },
        }
    })
}
