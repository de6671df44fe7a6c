//! `rig console` as a process, and a client that sends whatever bytes it likes.

// Each test uses some of it.
#![allow(dead_code)]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::command_support::rig;

/// A client gives up after this.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A console that answers; ended when dropped.
pub struct Console {
    pub child: Child,
    pub stdout: BufReader<ChildStdout>,
    pub port: u16,
    pub token: String,
    stderr: std::path::PathBuf,
}

impl Drop for Console {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Console {
    /// With these arguments, in this folder; stderr goes into a file there.
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        let stderr = folder.join("console-stderr.txt");
        let mut child = rig(folder, arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(fs::File::create(&stderr).unwrap())
            .spawn()
            .unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").unwrap_or_else(|| {
            panic!("{line:?}: {}", fs::read_to_string(&stderr).unwrap());
        });
        let (host, token) = address.trim_end_matches('/').split_once('/').unwrap();
        let port = host.rsplit_once(':').unwrap().1.parse().unwrap();
        let token = token.to_owned();
        Self {
            child,
            stdout,
            port,
            token,
            stderr,
        }
    }

    pub fn stderr(&self) -> String {
        fs::read_to_string(&self.stderr).unwrap()
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(SocketAddr::from(([127, 0, 0, 1], self.port))).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.set_write_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// The text with `{T}` as the token and `{H}` as the host.
    pub fn filled(&self, text: &str) -> String {
        let host = format!("127.0.0.1:{}", self.port);
        text.replace("{T}", &self.token).replace("{H}", &host)
    }

    /// Sends bytes and reads all that comes; a broken connection ends it.
    pub fn exchange(&self, bytes: &[u8]) -> Answer {
        let mut stream = self.connect();
        let _ = stream.write_all(bytes);
        Answer::read(&mut stream)
    }

    pub fn get(&self, path: &str) -> Answer {
        let request = format!("GET /{{T}}{path} HTTP/1.1\r\nHost: {{H}}\r\n\r\n");
        self.exchange(self.filled(&request).as_bytes())
    }

    /// An action of the page, by this viewer.
    pub fn post(&self, viewer: &str, path: &str, body: &Value) -> Answer {
        let body = body.to_string();
        let head = self.filled(&format!(
            "POST /{{T}}{path} HTTP/1.1\r\nHost: {{H}}\r\nOrigin: http://{{H}}\r\n\
             Sec-Fetch-Site: same-origin\r\nContent-Type: application/json\r\n\
             X-Rig-Viewer: {viewer}\r\nContent-Length: {}\r\n\r\n",
            body.len()
        ));
        self.exchange(format!("{head}{body}").as_bytes())
    }

    /// The stream of events of this viewer.
    pub fn events(&self, viewer: &str) -> Events {
        let mut stream = self.connect();
        let request =
            format!("GET /{{T}}/api/events?viewer={viewer} HTTP/1.1\r\nHost: {{H}}\r\n\r\n");
        stream.write_all(self.filled(&request).as_bytes()).unwrap();
        Events(BufReader::new(stream))
    }

    /// Waits for the end of the process; its exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            let stderr = self.stderr();
            assert!(began.elapsed() < Duration::from_secs(60), "{stderr}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub fn send(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, signal).unwrap();
    }
}

/// What came back: status 0 if nothing did.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn read(stream: &mut TcpStream) -> Self {
        let mut bytes = Vec::new();
        let mut piece = [0; 4096];
        while let Ok(count @ 1..) = stream.read(&mut piece) {
            bytes.extend_from_slice(&piece[..count]);
        }
        let end = bytes.windows(4).position(|part| part == b"\r\n\r\n");
        let end = end.map_or(bytes.len(), |end| end + 4);
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = head.strip_prefix("HTTP/1.").and_then(|rest| rest.get(2..5));
        Self {
            status: status.and_then(|code| code.parse().ok()).unwrap_or(0),
            head,
            body: bytes[end..].to_vec(),
        }
    }

    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{self:?}"))
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// A stream of events.
pub struct Events(BufReader<TcpStream>);

impl Events {
    /// The first line of the answer.
    pub fn status(&mut self) -> String {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    /// Waits for a state of this topic that is as wanted.
    #[track_caller]
    pub fn wait_for(&mut self, topic: &str, is_wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        let mut last = Value::Null;
        let mut line = String::new();
        let mut event = String::new();
        loop {
            line.clear();
            let count = self.0.read_line(&mut line).unwrap();
            assert!(count > 0, "the stream ended; last {topic}: {last}");
            if let Some(name) = line.strip_prefix("event: ") {
                event = name.trim().to_owned();
            } else if let Some(data) = line.strip_prefix("data: ")
                && event == topic
            {
                last = serde_json::from_str(data).unwrap();
                if is_wanted(&last) {
                    return last;
                }
            }
            assert!(began.elapsed() < Duration::from_secs(120), "last: {last}");
        }
    }
}
