//! Which names the console answers to: a page of elsewhere whose name is made to point at
//! this address (DNS rebinding) comes with its own.

use std::net::{IpAddr, SocketAddr};

/// The addresses and names that a request may have in its `Host`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hosts {
    listening: SocketAddr,
    names: Vec<String>,
}

impl Hosts {
    /// For a server at this address that is also reached under these names, at any port: the
    /// port of a proxy is not known here.
    pub fn new(listening: SocketAddr, names: &[String]) -> Self {
        let names = names.iter().map(|name| name.to_ascii_lowercase());
        Self {
            listening,
            names: names.collect(),
        }
    }

    /// Whether a request may call the server so.
    pub fn admit(&self, host: &str) -> bool {
        let Some((name, port)) = parts(host) else {
            return false;
        };
        if self.has_name(&name) {
            return true;
        }
        if port != self.listening.port() {
            return false;
        }
        let own = self.listening.ip();
        let bare = name.trim_start_matches('[').trim_end_matches(']');
        match bare.parse::<IpAddr>() {
            Ok(ip) => ip.is_ipv6() == name.starts_with('[') && (own.is_unspecified() || ip == own),
            Err(_) => name == "localhost" && (own.is_loopback() || own.is_unspecified()),
        }
    }

    /// Whether a request with this `Host` may come from a page of this origin: the page of
    /// the host itself. Behind a proxy with a name its own connection is encrypted.
    pub fn admit_origin(&self, origin: &str, host: &str) -> bool {
        if let Some(named) = origin.strip_prefix("http://") {
            return named.eq_ignore_ascii_case(host);
        }
        let Some(named) = origin.strip_prefix("https://") else {
            return false;
        };
        named.eq_ignore_ascii_case(host)
            && parts(host).is_some_and(|(name, _)| self.has_name(&name))
    }

    fn has_name(&self, name: &str) -> bool {
        self.names.iter().any(|known| known == name)
    }
}

/// Whether a text is a name alone, as a browser puts it into its `Host`: labels of letters,
/// digits, hyphens and underscores between dots (RFC 1123, and what networks at home have).
pub fn is_host_name(text: &str) -> bool {
    let is_label = |label: &str| {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        (1..=63).contains(&label.len())
            && label.chars().all(allowed)
            && !label.starts_with('-')
            && !label.ends_with('-')
    };
    text.len() <= 253 && text.split('.').all(is_label)
}

/// Name or address in lower case, and the port (80 where none is named).
fn parts(host: &str) -> Option<(String, u16)> {
    let is_bare = host.starts_with('[') && host.ends_with(']');
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !is_bare => (name, port.parse().ok()?),
        _ => (host, 80),
    };
    let is_one = !name.is_empty() && (name.starts_with('[') || !name.contains(':'));
    is_one.then(|| (name.to_ascii_lowercase(), port))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hosts(listening: &str, names: &[&str]) -> Hosts {
        let names: Vec<_> = names.iter().map(|&name| name.to_owned()).collect();
        Hosts::new(listening.parse().unwrap(), &names)
    }

    #[test]
    fn a_request_must_call_the_server_by_its_own_name() {
        let all = [
            "127.0.0.1:81",
            "localhost:81",
            "LOCALHOST:81",
            "10.0.0.5:81",
            "[::1]:81",
            "127.0.0.1",
            "127.0.0.1:82",
            "::1:81",
            "[127.0.0.1]:81",
            "rebound.example:81",
            "bench.lab",
            "Bench.lab:443",
            "bench.lab.:81",
            "127.0.0.1:81:81",
            "127.0.0.1:x",
            "",
            ":81",
        ];
        for (listening, names, admitted) in [
            ("127.0.0.1:81", &[][..], &all[..3]),
            (
                "[::1]:81",
                &[],
                &["localhost:81", "LOCALHOST:81", "[::1]:81"],
            ),
            ("10.0.0.5:81", &[], &["10.0.0.5:81"]),
            ("0.0.0.0:81", &[], &all[..5]),
            (
                "10.0.0.5:81",
                &["bench.Lab"],
                &["10.0.0.5:81", "bench.lab", "Bench.lab:443"],
            ),
        ] {
            let hosts = hosts(listening, names);
            let found: Vec<_> = all.into_iter().filter(|host| hosts.admit(host)).collect();
            assert_eq!(found, admitted, "{listening}");
        }
        let web = hosts("127.0.0.1:80", &[]);
        assert!(web.admit("127.0.0.1") && web.admit("localhost:80"));
    }

    #[test]
    fn an_origin_is_that_of_the_host_and_encrypted_only_under_a_given_name() {
        let hosts = hosts("127.0.0.1:81", &["bench.lab"]);
        for (origin, host, admitted) in [
            ("http://127.0.0.1:81", "127.0.0.1:81", true),
            ("https://127.0.0.1:81", "127.0.0.1:81", false),
            ("http://localhost:81", "127.0.0.1:81", false),
            ("null", "127.0.0.1:81", false),
            ("http://evil.example", "127.0.0.1:81", false),
            ("http://127.0.0.1:81.evil.example", "127.0.0.1:81", false),
            ("https://bench.lab", "bench.lab", true),
            ("https://evil.example", "bench.lab", false),
        ] {
            assert_eq!(hosts.admit_origin(origin, host), admitted, "{origin}");
        }
    }
}
