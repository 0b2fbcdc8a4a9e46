//! Who may read and who may control.
//!
//! Everybody who reaches the port may load the page itself: it holds no data. Data needs the token of the printed link,
//! or a connection that a process of the same user made on this machine. Control always needs the token.
//!
//! A web site may point its own name to this machine and ask through the browser of a user. Its requests carry that name
//! as `Host`, so names are refused. An address or `localhost` can't be pointed elsewhere: with any port they are a page
//! that was opened through a tunnel, and the token decides. Without the token, `Host` must be the very address of the
//! connection.
//!
//! A browser adds the `Origin` of the page that asks. Without the token it must be the one that `Host` names. With the token
//! it may have another scheme or port, or any name of the loopback interface: what stands in between may add TLS or write
//! its own `Host`. Only the page of the printed link knows the token.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};

use crate::http::Request;
use crate::peer::uid_of_peer;

/// Random bytes of a token: 128 bits.
const TOKEN_BYTES: usize = 16;

/// A secret that the printed link carries in its fragment, which no browser sends to a server by itself.
#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// A kernel without random numbers.
    pub(crate) fn random() -> anyhow::Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        let filled = rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty())?;
        anyhow::ensure!(filled == TOKEN_BYTES, "the kernel gives no random numbers");
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// Its 32 letters.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }

    /// Whether it is `given`, in a time that does not depend on the first letter that differs.
    fn is(&self, given: &str) -> bool {
        let difference =
            self.0.bytes().zip(given.bytes()).fold(0, |found, (own, other)| found | (own ^ other));
        self.0.len() == given.len() && difference == 0
    }
}

/// What a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    /// The page, without any data.
    Page,
    /// Samples and states.
    Data,
    /// A change of the running system.
    Control,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Refusal {
    /// `Host` is missing or is a name that a site may have pointed here.
    Host,
    /// `Origin` is another site.
    Origin,
    /// The token is missing or wrong.
    Token,
}

impl Refusal {
    /// What the client is told.
    pub(crate) fn text(self) -> &'static str {
        match self {
            Self::Host => "open the page by an address or as localhost, not by another name",
            Self::Origin => "requests of other sites are refused",
            Self::Token => "open the link that `scanloop view` printed: it carries the token",
        }
    }
}

/// Decides about a request that came from `peer` to `local`.
///
/// # Errors
/// Why it is refused.
pub(crate) fn admit(
    token: &Token,
    need: Need,
    request: &Request,
    peer: SocketAddr,
    local: SocketAddr,
) -> Result<(), Refusal> {
    let host = request.host.as_deref().filter(|host| is_unnamed(host)).ok_or(Refusal::Host)?;
    let has_token = request.token.as_deref().is_some_and(|given| token.is(given));
    let is_ours = |origin: &str| is_same(origin, host) || has_token && is_of_this_machine(origin, host);
    if !request.origin.as_deref().is_none_or(is_ours) {
        return Err(Refusal::Origin);
    }
    let is_this_user = || {
        let own = rustix::process::geteuid().as_raw();
        is_own(host, local)
            && peer.ip().to_canonical().is_loopback()
            && uid_of_peer(peer, local).is_some_and(|uid| uid == own || uid == 0)
    };
    let admitted = match need {
        Need::Page => true,
        Need::Data => has_token || is_this_user(),
        Need::Control => has_token,
    };
    if admitted { Ok(()) } else { Err(Refusal::Token) }
}

/// Whether an origin is the page that is served as `host`, without encryption.
fn is_same(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://").is_some_and(|site| parts(site, "80") == parts(host, "80"))
}

/// Whether an origin is a site of this machine: it has the name in `host`, or one of the loopback interface.
fn is_of_this_machine(origin: &str, host: &str) -> bool {
    let site = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    site.is_some_and(|site| {
        let (name, _port) = parts(site, "");
        is_unnamed(site) && (name == parts(host, "").0 || is_loopback(&name))
    })
}

/// The name in small letters, and the port.
fn parts<'a>(host: &'a str, default_port: &'a str) -> (String, &'a str) {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => (name, port),
        _ => (host, default_port),
    };
    (name.to_ascii_lowercase(), port)
}

/// Whether a name leads to this machine wherever it is used: `localhost`, or an address of the loopback interface.
fn is_loopback(name: &str) -> bool {
    let bare = name.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(name);
    name == "localhost" || bare.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.to_canonical().is_loopback())
}

/// Whether `host` is an address or `localhost`, which no web site can point to another machine.
fn is_unnamed(host: &str) -> bool {
    let (name, port) = parts(host, "80");
    let bare = name.strip_prefix('[').and_then(|inner| inner.strip_suffix(']'));
    let is_address = match bare {
        Some(inner) => inner.parse::<Ipv6Addr>().is_ok(),
        None => name.parse::<Ipv4Addr>().is_ok(),
    };
    port.parse::<u16>().is_ok() && (is_address || name == "localhost")
}

/// Whether `host` is the address at which the connection arrived.
fn is_own(host: &str, local: SocketAddr) -> bool {
    let (ip, port) = (local.ip().to_canonical(), local.port());
    let named = host.parse::<SocketAddr>().is_ok_and(|given| given == SocketAddr::new(ip, port));
    named || ip.is_loopback() && host == format!("localhost:{port}") || port == 80 && host == ip.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(host: &str, origin: Option<&str>, token: Option<&str>) -> Request {
        let owned = |text: &str| text.to_owned();
        Request {
            host: Some(host.to_owned()),
            origin: origin.map(owned),
            token: token.map(owned),
            ..Request::default()
        }
    }

    fn local() -> SocketAddr {
        "127.0.0.1:7117".parse().unwrap()
    }

    /// No connection of this user: a port that nothing uses.
    fn stranger() -> SocketAddr {
        "127.0.0.1:1".parse().unwrap()
    }

    fn admitted(need: Need, request: &Request) -> Result<(), Refusal> {
        admit(&Token("f".repeat(32)), need, request, stranger(), local())
    }

    #[test]
    fn a_token_has_128_random_bits() {
        let tokens = [Token::random().unwrap(), Token::random().unwrap()];
        assert!(tokens[0] != tokens[1] && tokens[0].text().len() == 32);
        assert!(tokens[0].is(tokens[0].text()) && !tokens[0].is(""));
        assert!(!tokens[0].is(&tokens[0].text()[..31]));
    }

    #[test]
    fn names_that_a_site_can_point_here_are_refused_even_with_the_token() {
        let token = "f".repeat(32);
        for host in [
            "evil.example:7117",
            "evil.example",
            "localhost.evil.example:7117",
            "127.0.0.1.evil.example",
            "",
            ":7117",
            "127.0.0.1:port",
            "127.0.0.1:99999",
            "0x7f000001:7117",
            "::1",
            "[::1",
            "[evil]:7117",
            "user@127.0.0.1:7117",
        ] {
            for need in [Need::Page, Need::Data, Need::Control] {
                let refused = admitted(need, &request(host, None, Some(&token)));
                assert_eq!(refused, Err(Refusal::Host), "{host}");
            }
        }
        assert_eq!(admitted(Need::Page, &Request::default()), Err(Refusal::Host));
    }

    #[test]
    fn through_a_tunnel_the_token_decides() {
        let token = "f".repeat(32);
        for host in
            ["localhost:8391", "127.0.0.1:80", "localhost", "[::1]:8391", "192.168.0.7:7117", "LocalHost:1"]
        {
            let origin = format!("http://{host}");
            for need in [Need::Page, Need::Data, Need::Control] {
                assert_eq!(admitted(need, &request(host, Some(&origin), Some(&token))), Ok(()), "{host}");
            }
            assert_eq!(admitted(Need::Page, &request(host, None, None)), Ok(()), "{host}");
            assert_eq!(admitted(Need::Data, &request(host, None, None)), Err(Refusal::Token), "{host}");
        }
    }

    #[test]
    fn the_own_address_is_compared_with_its_port() {
        assert!(is_own("127.0.0.1:7117", local()) && is_own("localhost:7117", local()));
        assert!(!is_own("127.0.0.1:80", local()) && !is_own("127.0.0.2:7117", local()));
        assert!(is_own("[::1]:80", "[::1]:80".parse().unwrap()));
        assert!(is_own("192.168.0.7:7117", "[::ffff:192.168.0.7]:7117".parse().unwrap()));
        assert!(!is_own("localhost:7117", "192.168.0.7:7117".parse().unwrap()));
    }

    #[test]
    fn a_user_needs_no_token_at_any_loopback_address() {
        for (host, at) in [("127.0.0.1:0", "127.0.0.1"), ("[::]:0", "127.0.0.1"), ("[::]:0", "::1")] {
            let Ok(listener) = std::net::TcpListener::bind(host) else { continue };
            let port = listener.local_addr().unwrap().port();
            let address = SocketAddr::new(at.parse().unwrap(), port);
            let Ok(_client) = std::net::TcpStream::connect(address) else { continue };
            let (server, peer) = listener.accept().unwrap();
            let asked = request(&address.to_string(), None, None);
            let found = admit(&Token("f".repeat(32)), Need::Data, &asked, peer, server.local_addr().unwrap());
            assert_eq!(found, Ok(()), "{host} at {at}");
        }
    }

    #[test]
    fn another_origin_is_refused_even_with_the_token() {
        let token = "f".repeat(32);
        for origin in [
            "http://evil.example",
            "https://evil.example:7117",
            "http://localhost.evil.example:7117",
            "http://127.0.0.1.evil.example",
            "http://user@127.0.0.1:7117",
            "http://127.0.0.1:7117/path",
            "http://192.168.0.8:7117",
            "http://[::2]:7117",
            "http://2130706433:7117",
            "ftp://127.0.0.1:7117",
            "127.0.0.1:7117",
            "http://",
            "",
            "null",
        ] {
            let asked = request("127.0.0.1:7117", Some(origin), Some(&token));
            for need in [Need::Page, Need::Data, Need::Control] {
                assert_eq!(admitted(need, &asked), Err(Refusal::Origin), "{origin}");
            }
        }
        let same = request("127.0.0.1:7117", Some("http://127.0.0.1:7117"), Some(&token));
        assert_eq!(admitted(Need::Control, &same), Ok(()));
    }

    #[test]
    fn with_the_token_another_port_or_scheme_of_this_machine_is_the_page_behind_a_tunnel() {
        let token = "f".repeat(32);
        for (host, origin) in [
            ("localhost:8443", "https://localhost:8443"),
            ("127.0.0.1:17820", "http://localhost:8080"),
            ("127.0.0.1:7117", "http://127.0.0.1:7118"),
            ("localhost:8080", "http://LOCALHOST:8080"),
            ("192.168.0.7:7117", "https://192.168.0.7"),
            ("127.0.0.1:7117", "https://[::1]:8443"),
        ] {
            for need in [Need::Page, Need::Data, Need::Control] {
                assert_eq!(admitted(need, &request(host, Some(origin), Some(&token))), Ok(()), "{origin}");
            }
            let wrong = "e".repeat(32);
            for given in [None, Some(wrong.as_str())] {
                let refused = admitted(Need::Control, &request(host, Some(origin), given));
                assert!(refused.is_err(), "{origin}");
            }
        }
        // The same origin, written in another way.
        for (host, origin) in [("localhost:80", "http://localhost"), ("LocalHost:1", "http://localhost:1")] {
            assert_eq!(admitted(Need::Page, &request(host, Some(origin), None)), Ok(()), "{origin}");
            assert_eq!(
                admitted(Need::Control, &request(host, Some(origin), Some(&token))),
                Ok(()),
                "{origin}"
            );
        }
        let without = request("127.0.0.1:7117", Some("http://127.0.0.1:7118"), None);
        assert_eq!(admitted(Need::Page, &without), Err(Refusal::Origin));
    }

    #[test]
    fn data_and_control_need_the_token_where_the_user_is_unknown() {
        let host = "127.0.0.1:7117";
        for need in [Need::Data, Need::Control] {
            assert_eq!(admitted(need, &request(host, None, None)), Err(Refusal::Token));
            assert_eq!(admitted(need, &request(host, None, Some(&"e".repeat(32)))), Err(Refusal::Token));
            assert_eq!(admitted(need, &request(host, None, Some(&"f".repeat(32)))), Ok(()));
        }
    }
}
