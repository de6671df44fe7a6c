//! The table of attacks: requests as bytes, and what each may come to.

use serde_json::json;

use crate::support::Console;

/// `{T}` is the token, `{H}` the host.
pub const HEAD: &str = "Host: {H}\r\n";
pub const ACTION: &str = "Host: {H}\r\nContent-Type: application/json\r\nX-Rig-Viewer: a\r\n";

/// Name, request, what it may come to; 0: the connection is closed without an answer.
pub type Row = (&'static str, Vec<u8>, &'static [u16]);

pub fn get(name: &'static str, path: &str, headers: &str, expected: &'static [u16]) -> Row {
    let request = format!("GET {path} HTTP/1.1\r\n{headers}\r\n");
    (name, request.into_bytes(), expected)
}

pub fn post(name: &'static str, path: &str, body: &str, expected: &'static [u16]) -> Row {
    with(name, path, ACTION, body, expected)
}

pub fn with(
    name: &'static str,
    path: &str,
    headers: &str,
    body: &str,
    expected: &'static [u16],
) -> Row {
    let length = body.len();
    let request =
        format!("POST /{{T}}{path} HTTP/1.1\r\n{headers}Content-Length: {length}\r\n\r\n{body}");
    (name, request.into_bytes(), expected)
}

pub fn raw(name: &'static str, request: impl AsRef<[u8]>, expected: &'static [u16]) -> Row {
    (name, request.as_ref().to_vec(), expected)
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
    let first = token.as_bytes()[0];
    let port = console.port;
    let page = "/{T}/";
    let stop = "/api/capture/stop";
    let action = |more: &str| format!("{ACTION}{more}\r\n");
    vec![
        get("no token", "/", HEAD, &[404]),
        get(
            "an action without token",
            "/api/events?viewer=a",
            HEAD,
            &[404],
        ),
        get(
            "another token",
            &format!("/{}/", "A".repeat(43)),
            HEAD,
            &[404],
        ),
        get(
            "a prefix of the token",
            &format!("/{}/", &token[..42]),
            HEAD,
            &[404],
        ),
        get("the token and more", "/{T}A/", HEAD, &[404]),
        get(
            "the token in other case",
            &format!("/{flipped}/"),
            HEAD,
            &[404],
        ),
        get(
            "the token percent-encoded",
            &format!("/%{first:02X}{}/", &token[1..]),
            HEAD,
            &[404],
        ),
        get("the token in the query", "/?token={T}", HEAD, &[404]),
        get(
            "the token in a cookie",
            "/",
            &format!("{HEAD}Cookie: token={{T}}\r\n"),
            &[404],
        ),
        get("the token after another segment", "/x/{T}/", HEAD, &[404]),
        get("two slashes before it", "//{T}/", HEAD, &[404]),
        get("a foreign Host", page, "Host: evil.example\r\n", &[403]),
        get("no Host", page, "", &[403]),
        get("two Hosts", page, &format!("{HEAD}{HEAD}"), &[403]),
        get(
            "a name that was rebound to this address",
            page,
            &format!("Host: rebound.example:{port}\r\n"),
            &[403],
        ),
        get("a Host with a user", page, "Host: x@{H}\r\n", &[400, 403]),
        get(
            "a Host with another port",
            page,
            "Host: 127.0.0.1:1\r\n",
            &[403],
        ),
        get(
            "another loopback address",
            page,
            &format!("Host: 127.0.0.2:{port}\r\n"),
            &[403],
        ),
        get(
            "an address in absolute form",
            "http://{H}/{T}/",
            HEAD,
            &[400],
        ),
        get(
            "a foreign Origin on GET",
            page,
            &format!("{HEAD}Origin: http://evil.example\r\n"),
            &[403],
        ),
        get(
            "a picture embedded elsewhere",
            "/{T}/api/live.jpg",
            &format!("{HEAD}Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\n"),
            &[403],
        ),
        with(
            "a foreign Origin",
            stop,
            &action("Origin: http://evil.example"),
            "{}",
            &[403],
        ),
        with(
            "the origin null",
            stop,
            &action("Origin: null"),
            "{}",
            &[403],
        ),
        with(
            "an encrypted origin of no name",
            stop,
            &action("Origin: https://{H}"),
            "{}",
            &[403],
        ),
        with(
            "two Origins",
            stop,
            &action("Origin: http://{H}\r\nOrigin: http://{H}"),
            "{}",
            &[403],
        ),
        with(
            "another site's form",
            stop,
            &action("Sec-Fetch-Site: cross-site"),
            "{}",
            &[403],
        ),
        with(
            "a site next door",
            stop,
            &action("Sec-Fetch-Site: same-site"),
            "{}",
            &[403],
        ),
        with(
            "a form's content type",
            stop,
            "Host: {H}\r\nX-Rig-Viewer: a\r\nContent-Type: application/x-www-form-urlencoded\r\n",
            "a=1",
            &[415],
        ),
        with(
            "text as content type",
            stop,
            "Host: {H}\r\nX-Rig-Viewer: a\r\nContent-Type: text/plain\r\n",
            "{}",
            &[415],
        ),
        with(
            "no content type",
            stop,
            "Host: {H}\r\nX-Rig-Viewer: a\r\n",
            "{}",
            &[415],
        ),
        with(
            "no viewer",
            stop,
            "Host: {H}\r\nContent-Type: application/json\r\n",
            "{}",
            &[400],
        ),
        with(
            "a viewer with a blank",
            stop,
            "Host: {H}\r\nContent-Type: application/json\r\nX-Rig-Viewer: a b\r\n",
            "{}",
            &[400],
        ),
        with(
            "two viewers",
            stop,
            &action("X-Rig-Viewer: b"),
            "{}",
            &[400],
        ),
        get("a stream without viewer", "/{T}/api/events", HEAD, &[400]),
        get(
            "a stream of a viewer with markup",
            "/{T}/api/events?viewer=%3Cscript%3E",
            HEAD,
            &[400],
        ),
    ]
}

/// Paths that lead elsewhere, methods that are none.
pub fn paths_and_methods() -> Vec<Row> {
    let gone: &[u16] = &[400, 403, 404];
    let mut rows: Vec<Row> = [
        ("traversal", "/../secret.txt"),
        ("traversal below sessions", "/sessions/../../secret.txt"),
        (
            "traversal in a session's name",
            "/sessions/..%2F..%2Fsecret.txt/report.html",
        ),
        (
            "traversal percent-encoded",
            "/sessions/%2e%2e/%2e%2e/secret.txt",
        ),
        (
            "traversal in a file's name",
            "/sessions/real/..%2F..%2F..%2Fsecret.txt",
        ),
        (
            "traversal encoded twice",
            "/sessions/real/%252e%252e%252fsecret.txt",
        ),
        (
            "traversal with backslashes",
            "/sessions/real/..%5C..%5Csecret.txt",
        ),
        ("an absolute path", "/sessions//etc/passwd"),
        (
            "an absolute path, encoded",
            "/sessions/real/%2Fetc%2Fpasswd",
        ),
        ("a path with NUL", "/sessions/real/report.html%00.png"),
        ("overlong UTF-8", "/sessions/%c0%ae%c0%ae/secret.txt"),
        (
            "a session that is a symbolic link",
            "/sessions/link/report.html",
        ),
        (
            "a file that is a symbolic link",
            "/sessions/real/report.html",
        ),
        ("the folder itself", "/sessions/"),
        ("details of a linked session", "/api/sessions/link"),
        ("details of elsewhere", "/api/sessions/..%2Felsewhere"),
        (
            "a comparison of a linked session",
            "/api/compare?fits=link:0/link:1",
        ),
        (
            "a comparison of elsewhere",
            "/api/compare?fits=..%2Felsewhere:0/real:0",
        ),
        ("a file that is not served", "/page/index.html"),
        (
            "the text of a rig file elsewhere",
            "/api/rigs/text?rig=..%2Farm.toml",
        ),
        ("the text of no rig file", "/api/rigs/text?rig=secret.txt"),
    ]
    .into_iter()
    .map(|(name, path)| get(name, &format!("/{{T}}{path}"), HEAD, gone))
    .collect();
    let method = |name: &'static str, method: &str, expected: &'static [u16]| {
        let request = format!("{method} /{{T}}/api/capture/stop HTTP/1.1\r\n{ACTION}\r\n");
        (name, request.into_bytes(), expected)
    };
    rows.extend([
        method("GET for an action", "GET", &[405]),
        method("HEAD for an action", "HEAD", &[405]),
        method("PUT", "PUT", &[405]),
        method("DELETE", "DELETE", &[405]),
        method("OPTIONS, a preflight", "OPTIONS", &[405]),
        method("TRACE", "TRACE", &[405]),
        method("a method that is none", "BREW", &[405]),
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
        post("POST for the page", "/", "{}", &[405]),
        post(
            "resume of elsewhere",
            "/api/capture/resume",
            r#"{"session": "../elsewhere"}"#,
            &[404],
        ),
        post(
            "resume of a link",
            "/api/capture/resume",
            r#"{"session": "link"}"#,
            &[404],
        ),
        post(
            "resume of an option",
            "/api/capture/resume",
            r#"{"session": "--help"}"#,
            &[404],
        ),
    ]);
    rows
}

/// Heads and bodies that are too long, cut short, or meant to be read in two ways.
pub fn forms() -> Vec<Row> {
    // Not STOP, whose body is not waited for.
    let pause = "/api/capture/pause";
    let x = |count: usize| "x".repeat(count);
    let many: String = (0..1000).map(|n| format!("X-{n}: y\r\n")).collect();
    let length = |length: &str| {
        format!("POST /{{T}}{pause} HTTP/1.1\r\n{ACTION}Content-Length: {length}\r\n\r\n{{}}")
    };
    // The second request is the smuggled one.
    let both = format!(
        "POST /{{T}}{pause} HTTP/1.1\r\n{ACTION}Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n\
         0\r\n\r\nGET /{{T}}/ HTTP/1.1\r\nHost: {{H}}\r\n\r\n"
    );
    let pipelined = "GET /{T}/nothing HTTP/1.1\r\nHost: {H}\r\n\r\n".repeat(3);
    vec![
        get(
            "a huge header",
            "/{T}/",
            &format!("{HEAD}X: {}\r\n", x(1 << 20)),
            &[431, 0],
        ),
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
        raw(
            "a body that is announced as huge",
            length("100000000"),
            &[413],
        ),
        with("a huge body", pause, ACTION, &x(1 << 20), &[413]),
        raw("a length that is negative", length("-1"), &[400]),
        raw("a length that is no number", length("2a"), &[400]),
        raw(
            "a length beyond any number",
            length("99999999999999999999999"),
            &[400],
        ),
        raw("two lengths", length("2\r\nContent-Length: 3"), &[400]),
        raw(
            "a body in chunks",
            format!(
                "POST /{{T}}{pause} HTTP/1.1\r\n{ACTION}Transfer-Encoding: chunked\r\n\r\n2\r\n{{}}\r\n0\r\n\r\n"
            ),
            &[411],
        ),
        raw("a length and chunks", both, &[400, 411]),
        raw(
            "an encoding that is none",
            format!(
                "POST /{{T}}{pause} HTTP/1.1\r\n{ACTION}Transfer-Encoding: xchunked\r\n\r\n{{}}"
            ),
            &[400, 411],
        ),
        raw("three requests at once", pipelined, &[404]),
        raw("a body that stops before its end", length("50"), &[408]),
        raw(
            "a STOP whose body never comes",
            format!("POST /{{T}}/api/capture/stop HTTP/1.1\r\n{ACTION}Content-Length: 50\r\n\r\n"),
            &[202],
        ),
        with(
            "a STOP with a huge body",
            "/api/bench/stop",
            ACTION,
            &x(1 << 20),
            &[409],
        ),
        raw(
            "Expect and no body",
            format!(
                "POST /{{T}}{pause} HTTP/1.1\r\n{ACTION}Expect: 100-continue\r\nContent-Length: 2\r\n\r\n"
            ),
            &[100],
        ),
        raw("HTTP/0.9", "GET /{T}/\r\n\r\n", &[400]),
        raw("HTTP/2", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", &[400, 0]),
        raw(
            "HTTP/1.0 without Host",
            "GET /{T}/ HTTP/1.0\r\n\r\n",
            &[403],
        ),
        raw(
            "a TLS greeting",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
            &[400],
        ),
        raw("bytes of no protocol", [0xff; 4096], &[400, 431, 0]),
        raw("nothing but line ends", "\r\n".repeat(9000), &[400, 431, 0]),
        raw(
            "a header without colon",
            "GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nnonsense\r\n\r\n",
            &[400],
        ),
        raw(
            "a folded header",
            "GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nX: a\r\n b\r\n\r\n",
            &[400, 200],
        ),
        raw(
            "a header with NUL",
            "GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nX: a\0b\r\n\r\n",
            &[400],
        ),
        raw(
            "a blank before the colon",
            "GET /{T}/ HTTP/1.1\r\nHost : {H}\r\n\r\n",
            &[400],
        ),
    ]
}

/// Bodies of actions that are no JSON, or ask for something else than they seem to.
pub fn bodies() -> Vec<Row> {
    let plan = "/api/plan";
    let sample = |name: &'static str, sample: &str, expected| {
        let body = json!({"sample": sample, "lights": "1"}).to_string();
        post(name, plan, &body, expected)
    };
    let nested = format!("{}{}", "[".repeat(30_000), "]".repeat(30_000));
    let utf8 = b"POST /{T}/api/plan HTTP/1.1\r\nHost: {H}\r\nContent-Type: application/json\r\n\
        X-Rig-Viewer: a\r\nContent-Length: 14\r\n\r\n{\"sample\":\"\xff\xfe\"}";
    vec![
        sample("a sample with a line end", "a\r\nX-Injected: 1", &[400]),
        sample(
            "a sample for a shell",
            "$(touch pwned); `touch pwned` & | > pwned",
            &[400],
        ),
        sample("a sample that is an option", "--help", &[400]),
        sample("a sample that is a path", "../../pwned", &[400]),
        sample("a sample with NUL", "a\0b", &[400]),
        sample("a sample that is too long", &"a".repeat(5000), &[400]),
        post(
            "lights that are an option",
            plan,
            r#"{"lights": "--help"}"#,
            &[422],
        ),
        post(
            "lights for a shell",
            plan,
            r#"{"lights": "1; touch pwned"}"#,
            &[422],
        ),
        post(
            "lights without end",
            plan,
            r#"{"lights": "99999999999999999999"}"#,
            &[422],
        ),
        post(
            "a light that is an option",
            plan,
            r#"{"light": ["--out=pwned"]}"#,
            &[422],
        ),
        post(
            "a light that is no number",
            plan,
            r#"{"light": ["NaN,inf"]}"#,
            &[422],
        ),
        post("nothing to capture", plan, "{}", &[422]),
        post("JSON that is nested without end", plan, &nested, &[400]),
        post(
            "objects that are nested without end",
            plan,
            &r#"{"a":"#.repeat(10_000),
            &[400],
        ),
        post("NaN", plan, r#"{"light": [NaN]}"#, &[400]),
        post("a number beyond all", plan, r#"{"light": [1e400]}"#, &[400]),
        post("another type", plan, r#"{"lights": 4}"#, &[400]),
        post(
            "a key twice",
            plan,
            r#"{"lights": "1", "lights": "2"}"#,
            &[400],
        ),
        post("no JSON", plan, "lights=4", &[400]),
        post("no body", plan, "", &[400]),
        post("two values", plan, "{}{}", &[400]),
        raw("no UTF-8", utf8, &[400]),
        post(
            "a bench elsewhere",
            "/api/rigs/use",
            r#"{"rig": "/etc/x.toml"}"#,
            &[404],
        ),
        post(
            "a bench that is an option",
            "/api/rigs/use",
            r#"{"rig": "--help"}"#,
            &[404],
        ),
        post(
            "a rig file elsewhere is saved",
            "/api/rigs/save",
            r#"{"rig": "../x.toml", "text": "", "sum": ""}"#,
            &[404],
        ),
        post(
            "a sample of the queue that is a path",
            "/api/queue/add",
            r#"{"text": "../../pwned"}"#,
            &[422],
        ),
        post(
            "a calibration that is none",
            "/api/guides/measure",
            r#"{"kind": "status", "values": {"out": "/tmp"}}"#,
            &[404],
        ),
        post(
            "an option that a calibration does not offer",
            "/api/guides/measure",
            r#"{"kind": "sensor", "values": {"out": "/tmp/pwned"}}"#,
            &[422],
        ),
        post(
            "a calibration of a session elsewhere",
            "/api/guides/measure",
            r#"{"kind": "pose", "sessions": ["../elsewhere"]}"#,
            &[404],
        ),
        post(
            "a calibration of a session that is a link",
            "/api/guides/measure",
            r#"{"kind": "pose", "sessions": ["link"]}"#,
            &[404],
        ),
        post(
            "lights of a target for a shell",
            "/api/guides/capture",
            r#"{"kind": "lights", "lights": "1; touch pwned"}"#,
            &[409, 422],
        ),
        post(
            "a record that nobody measured",
            "/api/guides/accept",
            "{}",
            &[409],
        ),
        post(
            "a queue of lights for a shell",
            "/api/queue/next",
            r#"{"lights": "1; touch pwned"}"#,
            &[422],
        ),
        post(
            "the next of no queue",
            "/api/queue/next",
            r#"{"lights": "1"}"#,
            &[409],
        ),
        post(
            "an answer that nobody asked for",
            "/api/capture/answer",
            r#"{"number": 1, "done": true}"#,
            &[409],
        ),
        post("pause without capture", "/api/capture/pause", "{}", &[409]),
        post("an action that is none", "/api/../api/plan", "{}", &[404]),
    ]
}
