//! A page that is served to this machine alone: HTTP/1.1 on a loopback port,
//! three paths, one connection per request.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// What the page shows; replaced as a whole with each frame.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// Counts up with each frame.
    pub number: u64,
    /// The picture, PNG.
    pub picture: Vec<u8>,
    /// The figures, JSON.
    pub figures: String,
}

/// The running server.
pub struct PreviewServer {
    address: SocketAddr,
    shown: Arc<Mutex<Arc<Shown>>>,
}

/// A request's head is at most so long.
const LONGEST_HEAD: u64 = 8192;
/// A client has so long to send its request and to take the answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Connections at once; browsers open about six.
const MOST_CONNECTIONS: usize = 16;

const PAGE: &str = include_str!("preview_page.html");

impl PreviewServer {
    /// Listens on `127.0.0.1`; port 0 takes a free one.
    ///
    /// # Errors
    /// If the port is taken or may not be used.
    pub fn start(port: u16) -> std::io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        let address = listener.local_addr()?;
        let shown = Arc::<Mutex<Arc<Shown>>>::default();
        let for_clients = Arc::clone(&shown);
        std::thread::Builder::new()
            .name("preview".into())
            .spawn(move || accept(&listener, address, &for_clients))?;
        Ok(Self { address, shown })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What is shown from now on.
    pub fn show(&self, shown: Shown) {
        *lock(&self.shown) = Arc::new(shown);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn accept(listener: &TcpListener, address: SocketAddr, shown: &Arc<Mutex<Arc<Shown>>>) {
    let open = Arc::new(AtomicUsize::new(0));
    for client in listener.incoming().flatten() {
        if open.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS {
            open.fetch_sub(1, Ordering::AcqRel);
            continue;
        }
        let (shown, open) = (Arc::clone(shown), Arc::clone(&open));
        std::thread::spawn(move || {
            // A client that goes away is none of our concern.
            let _ = serve(client, address, &shown);
            open.fetch_sub(1, Ordering::AcqRel);
        });
    }
}

fn serve(
    mut client: TcpStream,
    address: SocketAddr,
    shown: &Mutex<Arc<Shown>>,
) -> std::io::Result<()> {
    client.set_read_timeout(Some(PATIENCE))?;
    client.set_write_timeout(Some(PATIENCE))?;
    let head = read_head(&client)?;
    let shown = Arc::clone(&lock(shown));
    let (status, kind, body) = answer(&head, address, &shown);
    write!(
        client,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    client.write_all(body)
}

/// The lines of a request up to the empty one.
fn read_head(client: &TcpStream) -> std::io::Result<Vec<String>> {
    let mut lines = Vec::new();
    for line in BufReader::new(client.take(LONGEST_HEAD)).lines() {
        let line = line?;
        if line.is_empty() {
            break;
        }
        lines.push(line);
    }
    Ok(lines)
}

/// Status, content type and body for a request's head.
///
/// The `Host` must be this machine: a page from elsewhere whose name was made to
/// mean 127.0.0.1 would otherwise read the pictures.
fn answer<'a>(
    head: &[String],
    address: SocketAddr,
    shown: &'a Shown,
) -> (&'static str, &'static str, &'a [u8]) {
    const TEXT: &str = "text/plain; charset=utf-8";
    let mut host = head.iter().filter_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("host").then(|| value.trim())
    });
    let port = address.port();
    let ours = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{port}"));
    if !host
        .next()
        .is_some_and(|host| ours.iter().any(|our| our == host))
    {
        return ("403 Forbidden", TEXT, b"only for this machine\n");
    }
    let mut words = head.first().map_or("", String::as_str).split(' ');
    let (method, path) = (words.next(), words.next().unwrap_or_default());
    if method != Some("GET") {
        return ("405 Method Not Allowed", TEXT, b"only GET\n");
    }
    match path.split('?').next().unwrap_or_default() {
        "/" => ("200 OK", "text/html; charset=utf-8", PAGE.as_bytes()),
        "/frame.png" | "/figures.json" if shown.number == 0 => {
            ("503 Service Unavailable", TEXT, b"no frame yet\n")
        }
        "/frame.png" => ("200 OK", "image/png", &shown.picture),
        "/figures.json" => ("200 OK", "application/json", shown.figures.as_bytes()),
        _ => (
            "404 Not Found",
            TEXT,
            b"there are /, /frame.png and /figures.json\n",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(address: SocketAddr, request: &str) -> String {
        let mut client = TcpStream::connect(address).unwrap();
        client.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        client.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    #[test]
    fn the_page_its_picture_and_its_figures_are_there_for_this_machine_alone() {
        let server = PreviewServer::start(0).unwrap();
        let address = server.address();
        assert!(address.ip().is_loopback());
        let get = |path: &str| {
            ask(
                address,
                &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n"),
            )
        };
        assert!(get("/").starts_with("HTTP/1.1 200") && get("/").contains("<!doctype html>"));
        assert!(get("/frame.png").starts_with("HTTP/1.1 503"));
        server.show(Shown {
            number: 1,
            picture: b"a picture".to_vec(),
            figures: "{\"number\": 1}".to_owned(),
        });
        assert!(get("/frame.png?1").ends_with("\r\n\r\na picture"));
        assert!(get("/figures.json").ends_with("{\"number\": 1}"));
        assert!(get("/etc/passwd").starts_with("HTTP/1.1 404"));
        for (request, status) in [
            ("GET / HTTP/1.1\r\nHost: elsewhere.example\r\n\r\n", "403"),
            ("GET / HTTP/1.1\r\n\r\n", "403"),
            ("nonsense\r\n\r\n", "403"),
        ] {
            let answer = ask(address, request);
            assert!(
                answer.starts_with(&format!("HTTP/1.1 {status}")),
                "{request}: {answer}"
            );
        }
        let post = format!(
            "POST / HTTP/1.1\r\nHost: localhost:{}\r\n\r\n",
            address.port()
        );
        assert!(ask(address, &post).starts_with("HTTP/1.1 405"));
        // A head that never ends is cut off, and the next one is answered.
        let mut client = TcpStream::connect(address).unwrap();
        let long = format!(
            "GET / HTTP/1.1\r\nX: {}",
            "x".repeat(2 * LONGEST_HEAD as usize)
        );
        let _ = client.write_all(long.as_bytes());
        let _ = client.read_to_end(&mut Vec::new());
        assert!(get("/").starts_with("HTTP/1.1 200"));
    }
}
