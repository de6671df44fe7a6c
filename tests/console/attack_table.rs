//! The table of attacks: requests as bytes, and what each may come to.

use serde_json::json;

use crate::command_support::cases;
use crate::support::Console;

/// `{T}` is the token, `{H}` the host.
const HEAD: &str = "Host: {H}\r\n";
pub const ACTION: &str = "Host: {H}\r\nContent-Type: application/json\r\nX-Rig-Viewer: a\r\n";

/// Name, request, what it may come to; 0: the connection is closed without an answer.
pub type Row = (String, Vec<u8>, Vec<u16>);

fn raw(name: &str, request: impl AsRef<[u8]>, expected: &[u16]) -> Row {
    (
        name.to_owned(),
        request.as_ref().to_vec(),
        expected.to_vec(),
    )
}

fn get(name: &str, path: &str, headers: &str, expected: &[u16]) -> Row {
    raw(
        name,
        format!("GET {path} HTTP/1.1\r\n{headers}\r\n"),
        expected,
    )
}

fn post(name: &str, path: &str, body: &str, expected: &[u16]) -> Row {
    with(name, path, ACTION, body, expected)
}

pub fn with(name: &str, path: &str, headers: &str, body: &str, expected: &[u16]) -> Row {
    let length = body.len();
    let request =
        format!("POST /{{T}}{path} HTTP/1.1\r\n{headers}Content-Length: {length}\r\n\r\n{body}");
    raw(name, request, expected)
}

/// The headers that a column of a table lists with `; ` between; `HEAD` and `ACTION` are above.
fn headers(column: &str) -> String {
    let headers = column.split("; ").map(|header| match header {
        "HEAD" => HEAD.to_owned(),
        "ACTION" => ACTION.to_owned(),
        "" => String::new(),
        other => format!("{other}\r\n"),
    });
    headers.collect()
}

/// A column of statuses.
fn statuses(column: &str) -> Vec<u16> {
    let each = column.split(' ').map(|status| status.parse().unwrap());
    each.collect()
}

/// Rows of name, path, headers and statuses.
fn gets(table: &str) -> impl Iterator<Item = Row> {
    cases(table)
        .map(|[name, path, more, expected]| get(name, path, &headers(more), &statuses(expected)))
}

/// Rows of name, path, body and statuses.
fn posts(table: &str) -> impl Iterator<Item = Row> {
    cases(table).map(|[name, path, body, expected]| post(name, path, body, &statuses(expected)))
}

/// Who may not come in at all, and whoever has the token and comes from elsewhere.
pub fn strangers(console: &Console) -> Vec<Row> {
    let token = &console.token;
    let flipped: String = token
        .chars()
        .map(|c| match c.is_ascii_lowercase() {
            true => c.to_ascii_uppercase(),
            false => c.to_ascii_lowercase(),
        })
        .collect();
    let encoded = format!("%{:02X}{}", token.as_bytes()[0], &token[1..]);
    let table = r"
        no token | / | HEAD | 404
        an action without token | /api/events?viewer=a | HEAD | 404
        another token | /{OTHER}/ | HEAD | 404
        a prefix of the token | /{PREFIX}/ | HEAD | 404
        the token and more | /{T}A/ | HEAD | 404
        the token in other case | /{FLIPPED}/ | HEAD | 404
        the token percent-encoded | /{ENCODED}/ | HEAD | 404
        the token in the query | /?token={T} | HEAD | 404
        the token in a cookie | / | HEAD; Cookie: token={T} | 404
        the token after another segment | /x/{T}/ | HEAD | 404
        two slashes before it | //{T}/ | HEAD | 404
        a foreign Host | /{T}/ | Host: evil.example | 403
        no Host | /{T}/ | | 403
        two Hosts | /{T}/ | HEAD; HEAD | 403
        a name that was rebound to this address | /{T}/ | Host: rebound.example:{PORT} | 403
        a Host with a user | /{T}/ | Host: x@{H} | 400 403
        a Host with another port | /{T}/ | Host: 127.0.0.1:1 | 403
        another loopback address | /{T}/ | Host: 127.0.0.2:{PORT} | 403
        an address in absolute form | http://{H}/{T}/ | HEAD | 400
        a foreign Origin on GET | /{T}/ | HEAD; Origin: http://evil.example | 403
        a picture embedded elsewhere | /{T}/api/live.jpg | HEAD; Sec-Fetch-Site: cross-site; Sec-Fetch-Mode: no-cors | 403
        a stream without viewer | /{T}/api/events | HEAD | 400
        a stream of a viewer with markup | /{T}/api/events?viewer=%3Cscript%3E | HEAD | 400
    "
    .replace("{OTHER}", &"A".repeat(43))
    .replace("{PREFIX}", &token[..42])
    .replace("{FLIPPED}", &flipped)
    .replace("{ENCODED}", &encoded)
    .replace("{PORT}", &console.port.to_string());
    let actions = cases(
        "
        a foreign Origin | ACTION; Origin: http://evil.example | {} | 403
        the origin null | ACTION; Origin: null | {} | 403
        an encrypted origin of no name | ACTION; Origin: https://{H} | {} | 403
        two Origins | ACTION; Origin: http://{H}; Origin: http://{H} | {} | 403
        another site's form | ACTION; Sec-Fetch-Site: cross-site | {} | 403
        a site next door | ACTION; Sec-Fetch-Site: same-site | {} | 403
        a form's content type | HEAD; X-Rig-Viewer: a; Content-Type: application/x-www-form-urlencoded | a=1 | 415
        text as content type | HEAD; X-Rig-Viewer: a; Content-Type: text/plain | {} | 415
        no content type | HEAD; X-Rig-Viewer: a | {} | 415
        no viewer | HEAD; Content-Type: application/json | {} | 400
        a viewer with a blank | HEAD; Content-Type: application/json; X-Rig-Viewer: a b | {} | 400
        two viewers | ACTION; X-Rig-Viewer: b | {} | 400
    ",
    );
    let actions = actions.map(|[name, more, body, expected]| {
        let stop = "/api/capture/stop";
        with(name, stop, &headers(more), body, &statuses(expected))
    });
    gets(&table).chain(actions).collect()
}

/// Paths that lead elsewhere, methods that are none.
pub fn paths_and_methods() -> Vec<Row> {
    let elsewhere = cases(
        "
        traversal | /../secret.txt
        traversal below sessions | /sessions/../../secret.txt
        traversal in a session's name | /sessions/..%2F..%2Fsecret.txt/report.html
        traversal percent-encoded | /sessions/%2e%2e/%2e%2e/secret.txt
        traversal in a file's name | /sessions/real/..%2F..%2F..%2Fsecret.txt
        traversal encoded twice | /sessions/real/%252e%252e%252fsecret.txt
        traversal with backslashes | /sessions/real/..%5C..%5Csecret.txt
        an absolute path | /sessions//etc/passwd
        an absolute path, encoded | /sessions/real/%2Fetc%2Fpasswd
        a path with NUL | /sessions/real/report.html%00.png
        overlong UTF-8 | /sessions/%c0%ae%c0%ae/secret.txt
        a session that is a symbolic link | /sessions/link/report.html
        a file that is a symbolic link | /sessions/real/report.html
        the folder itself | /sessions/
        details of a linked session | /api/sessions/link
        details of elsewhere | /api/sessions/..%2Felsewhere
        a comparison of a linked session | /api/compare?fits=link:0/link:1
        a comparison of nothing | /api/compare
        a comparison of one | /api/compare?fits=real:0
        a comparison of fits that are not there | /api/compare?fits=real:0/real:99999999999
        a comparison of what is no fit | /api/compare?fits=real:-1/real:..
        a comparison of too many | /api/compare?fits=real:0/real:1/real:2/real:3/real:4/real:5
        a comparison with NUL | /api/compare?fits=real%00:0/real:1
        no rig file | /api/rigs/text
        a figure of a calibration that nobody measured | /api/guides/figure.png
        a comparison of elsewhere | /api/compare?fits=..%2Felsewhere:0/real:0
        a file that is not served | /page/index.html
        the text of a rig file elsewhere | /api/rigs/text?rig=..%2Farm.toml
        the text of no rig file | /api/rigs/text?rig=secret.txt
    ",
    );
    let elsewhere =
        elsewhere.map(|[name, path]| get(name, &format!("/{{T}}{path}"), HEAD, &[400, 403, 404]));
    let methods = [
        ("GET for an action", "GET"),
        ("HEAD for an action", "HEAD"),
        ("PUT", "PUT"),
        ("DELETE", "DELETE"),
        ("OPTIONS, a preflight", "OPTIONS"),
        ("TRACE", "TRACE"),
        ("a method that is none", "BREW"),
    ];
    let methods = methods.map(|(name, method)| {
        let request = format!("{method} /{{T}}/api/capture/stop HTTP/1.1\r\n{ACTION}\r\n");
        raw(name, request, &[405])
    });
    let targets = [
        raw(
            "CONNECT",
            "CONNECT {H} HTTP/1.1\r\nHost: {H}\r\n\r\n",
            &[400, 404],
        ),
        raw(
            "the asterisk",
            "OPTIONS * HTTP/1.1\r\nHost: {H}\r\n\r\n",
            &[404],
        ),
    ];
    let posts = posts(
        r#"
        POST for the page | / | {} | 405
        resume of elsewhere | /api/capture/resume | {"session": "../elsewhere"} | 404
        resume of a link | /api/capture/resume | {"session": "link"} | 404
        resume of an option | /api/capture/resume | {"session": "--help"} | 404
    "#,
    );
    elsewhere
        .chain(methods)
        .chain(targets)
        .chain(posts)
        .collect()
}

/// Heads and bodies that are too long, cut short, or meant to be read in two ways.
pub fn forms() -> Vec<Row> {
    // Not STOP, whose body is not waited for.
    let pause = "/api/capture/pause";
    let x = |count: usize| "x".repeat(count);
    let many: String = (0..1000).map(|n| format!("X-{n}: y\r\n")).collect();
    let long = format!("{HEAD}X: {}\r\n", x(1 << 20));
    let pipelined = "GET /{T}/nothing HTTP/1.1\r\nHost: {H}\r\n\r\n".repeat(3);
    let mut rows = vec![
        get("a huge header", "/{T}/", &long, &[431, 0]),
        get(
            "a thousand headers",
            "/{T}/",
            &format!("{HEAD}{many}"),
            &[431, 0],
        ),
        get(
            "a very long path",
            &format!("/{{T}}/{}", x(60_000)),
            HEAD,
            &[414, 431, 0],
        ),
        get(
            "a very long path without token",
            &format!("/{}", x(12_000)),
            HEAD,
            &[404, 414, 431],
        ),
        with("a huge body", pause, ACTION, &x(1 << 20), &[413]),
        with(
            "a STOP with a huge body",
            "/api/bench/stop",
            ACTION,
            &x(1 << 20),
            &[409],
        ),
        raw("three requests at once", pipelined, &[404]),
        raw(
            "a TLS greeting",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
            &[400],
        ),
        raw("bytes of no protocol", [0xff; 4096], &[400, 431, 0]),
        raw("nothing but line ends", "\r\n".repeat(9000), &[400, 431, 0]),
    ];
    // Name, action, what follows its headers, statuses; in `both` the second request is the
    // smuggled one.
    let actions = cases(
        r"
        a body that is announced as huge | pause | Content-Length: 100000000\r\n\r\n{} | 413
        a length that is negative | pause | Content-Length: -1\r\n\r\n{} | 400
        a length that is no number | pause | Content-Length: 2a\r\n\r\n{} | 400
        a length beyond any number | pause | Content-Length: 99999999999999999999999\r\n\r\n{} | 400
        two lengths | pause | Content-Length: 2\r\nContent-Length: 3\r\n\r\n{} | 400
        a body in chunks | pause | Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n | 411
        a length and chunks | pause | Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /{T}/ HTTP/1.1\r\nHost: {H}\r\n\r\n | 400 411
        an encoding that is none | pause | Transfer-Encoding: xchunked\r\n\r\n{} | 400 411
        a body that stops before its end | pause | Content-Length: 50\r\n\r\n{} | 408
        a STOP whose body never comes | stop | Content-Length: 50\r\n\r\n | 202
        Expect and no body | pause | Expect: 100-continue\r\nContent-Length: 2\r\n\r\n | 100
    ",
    );
    rows.extend(actions.map(|[name, action, rest, expected]| {
        let rest = rest.replace(r"\r\n", "\r\n");
        let request = format!("POST /{{T}}/api/capture/{action} HTTP/1.1\r\n{ACTION}{rest}");
        raw(name, request, &statuses(expected))
    }));
    let heads = cases(
        r"
        HTTP/0.9 | GET /{T}/\r\n\r\n | 400
        HTTP/2 | PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n | 400 0
        HTTP/1.0 without Host | GET /{T}/ HTTP/1.0\r\n\r\n | 403
        a header without colon | GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nnonsense\r\n\r\n | 400
        a folded header | GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nX: a\r\n b\r\n\r\n | 400 200
        a header with NUL | GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nX: a\0b\r\n\r\n | 400
        a blank before the colon | GET /{T}/ HTTP/1.1\r\nHost : {H}\r\n\r\n | 400
    ",
    );
    rows.extend(heads.map(|[name, request, expected]| {
        let request = request.replace(r"\r\n", "\r\n").replace(r"\0", "\0");
        raw(name, request, &statuses(expected))
    }));
    rows
}

/// Bodies of actions that are no JSON, or ask for something else than they seem to.
pub fn bodies() -> Vec<Row> {
    let plan = "/api/plan";
    let nested = format!("{}{}", "[".repeat(30_000), "]".repeat(30_000));
    let objects = r#"{"a":"#.repeat(10_000);
    let utf8 = b"POST /{T}/api/plan HTTP/1.1\r\nHost: {H}\r\nContent-Type: application/json\r\n\
        X-Rig-Viewer: a\r\nContent-Length: 14\r\n\r\n{\"sample\":\"\xff\xfe\"}";
    let mut rows = vec![
        post("JSON that is nested without end", plan, &nested, &[400]),
        post(
            "objects that are nested without end",
            plan,
            &objects,
            &[400],
        ),
        raw("no UTF-8", utf8, &[400]),
    ];
    let samples = [
        ("a sample with a line end", "a\r\nX-Injected: 1"),
        (
            "a sample for a shell",
            "$(touch pwned); `touch pwned` & | > pwned",
        ),
        ("a sample that is an option", "--help"),
        ("a sample that is a path", "../../pwned"),
        ("a sample with NUL", "a\0b"),
        ("a sample that is too long", &"a".repeat(5000)),
    ];
    rows.extend(samples.map(|(name, sample)| {
        let body = json!({"sample": sample, "lights": "1"}).to_string();
        post(name, plan, &body, &[400])
    }));
    rows.extend(posts(
        r#"
        lights that are an option | /api/plan | {"lights": "--help"} | 422
        lights for a shell | /api/plan | {"lights": "1; touch pwned"} | 422
        lights without end | /api/plan | {"lights": "99999999999999999999"} | 422
        a light that is an option | /api/plan | {"light": ["--out=pwned"]} | 422
        a light that is no number | /api/plan | {"light": ["NaN,inf"]} | 422
        nothing to capture | /api/plan | {} | 422
        NaN | /api/plan | {"light": [NaN]} | 400
        a number beyond all | /api/plan | {"light": [1e400]} | 400
        another type | /api/plan | {"lights": 4} | 400
        a key twice | /api/plan | {"lights": "1", "lights": "2"} | 400
        no JSON | /api/plan | lights=4 | 400
        no body | /api/plan | | 400
        two values | /api/plan | {}{} | 400
        a bench elsewhere | /api/rigs/use | {"rig": "/etc/x.toml"} | 404
        a bench that is an option | /api/rigs/use | {"rig": "--help"} | 404
        a rig file elsewhere is saved | /api/rigs/save | {"rig": "../x.toml", "text": "", "sum": ""} | 404
        a sample of the queue that is a path | /api/queue/add | {"text": "../../pwned"} | 422
        a sample of the queue that is nothing | /api/queue/add | {"text": " "} | 422
        a table of the queue with NUL | /api/queue/add | {"text": "name\na\u0000b"} | 422
        a table of the queue that has no end | /api/queue/add | {"text": "name,comment\na,\"b"} | 422
        repeats without end | /api/queue/add | {"text": "name,repeats\na,99999999999999999999"} | 422
        a sample that no queue has is left out | /api/queue/skip | {"sample": "../../pwned"} | 404 409 422
        a sample that no queue has is brought back | /api/queue/back | {"sample": "a"} | 404 409 422
        nothing to repeat | /api/queue/again | {} | 409
        an error for the queue that is none | /api/queue/next | {"lights": "1", "until": "NaN"} | 422
        an error for the queue that is an option | /api/queue/next | {"lights": "1", "until": "--out=pwned"} | 422
        lights at most without end | /api/queue/next | {"lights": "1", "until": "5", "max_lights": "99999999999"} | 422
        a lamp that is none | /api/bench/lamp | {"channel": 256} | 400
        a lamp that is another's | /api/bench/lamp | {"channel": 0, "out": "pwned"} | 400
        an exposure that is no time | /api/bench/exposure | {"exposure_ms": 1e999, "gain": 1} | 400
        a move without an azimuth | /api/bench/move | {"azimuth_deg": null, "elevation_deg": 1} | 400
        a rig file's text that is none | /api/rigs/save | {"rig": "secret.txt", "text": "x", "sum": ""} | 404
        a bench that runs a program | /api/setup | {"answers": {"camera": "command", "camera_address": "touch pwned"}} | 422
        a bench of a name elsewhere | /api/setup | {"answers": {"name": "../pwned"}} | 409 422
        a fit of a session elsewhere | /api/sessions/..%2Felsewhere/fit | {} | 400 404
        a fit of a session that is a link | /api/sessions/link/fit | {} | 404
        a fit of a dictionary elsewhere | /api/sessions/real/fit | {"dictionary": "/etc/passwd"} | 404 422
        a fit with an option of the program | /api/sessions/real/fit | {"out": "/tmp/pwned"} | 400 404
        an export of a session that is a link | /api/sessions/link/export | {"fit": "0", "format": "merl"} | 404
        an export of a fit elsewhere | /api/sessions/real/export | {"fit": "../0", "format": "merl"} | 400 404
        an export of a fit beyond all | /api/sessions/real/export | {"fit": "99999999999", "format": "merl"} | 400 404
        an export of a fit that is not there | /api/sessions/real/export | {"fit": "0", "format": "merl"} | 404
        an export of no format | /api/sessions/real/export | {"fit": "0", "format": "--help"} | 400 404
        an export that names its file | /api/sessions/real/export | {"fit": "0", "format": "merl", "out": "pwned"} | 400
        a certificate of no fit | /api/sessions/real/export | {"fit": "0", "format": "certificate"} | 404
        a target that is none is looked for | /api/guides/check | {"kind": "../x"} | 404
        a target in no picture | /api/guides/check | {"kind": "flat"} | 409
        parts of the image without end | /api/guides/check | {"kind": "white", "values": {"reflectance": "0.98", "reflectance-std": "0", "region": "0,0,1,99999999999999999999999"}} | 422
        a capture for a calibration that takes none | /api/guides/capture | {"kind": "sensor", "lights": "1"} | 409
        nothing to discard | /api/guides/discard | {} | 409
        a calibration that is none | /api/guides/measure | {"kind": "status", "values": {"out": "/tmp"}} | 404
        an option that a calibration does not offer | /api/guides/measure | {"kind": "sensor", "values": {"out": "/tmp/pwned"}} | 422
        a calibration of a session elsewhere | /api/guides/measure | {"kind": "pose", "sessions": ["../elsewhere"]} | 404
        a calibration of a session that is a link | /api/guides/measure | {"kind": "pose", "sessions": ["link"]} | 404
        lights of a target for a shell | /api/guides/capture | {"kind": "lights", "lights": "1; touch pwned"} | 409 422
        a record that nobody measured | /api/guides/accept | {} | 409
        a queue of lights for a shell | /api/queue/next | {"lights": "1; touch pwned"} | 422
        the next of no queue | /api/queue/next | {"lights": "1"} | 409
        an answer that nobody asked for | /api/capture/answer | {"number": 1, "done": true} | 409
        pause without capture | /api/capture/pause | {} | 409
        an action that is none | /api/../api/plan | {} | 404
    "#,
    ));
    rows
}

/// What acts.
pub const ACTIONS: &[&str] = &[
    "bench/connect",
    "bench/disconnect",
    "bench/exposure",
    "bench/home",
    "bench/lamp",
    "bench/move",
    "capture/answer",
    "capture/continue",
    "capture/finish",
    "capture/pause",
    "capture/resume",
    "capture/start",
    "control/ping",
    "control/release",
    "control/take",
    "guides/accept",
    "guides/capture",
    "guides/check",
    "guides/discard",
    "guides/measure",
    "plan",
    "queue/add",
    "queue/again",
    "queue/back",
    "queue/next",
    "queue/skip",
    "rigs/save",
    "rigs/use",
    "sessions/real/export",
    "sessions/real/fit",
    "setup",
];
