//! Who may read and who may control.
//!
//! Everybody who reaches the port may load the page itself: it holds no data. Data needs the token of the printed link,
//! or a connection that a process of the same user made on this machine. Control always needs the token. A request
//! whose `Host` is not the address it came to is refused: otherwise a web site could point its own name to this machine
//! and read through the browser of a user.

use std::net::{IpAddr, SocketAddr};

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
    /// `Host` is missing or is not the address of the connection.
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
            Self::Host => "open the page by its address, not by another name",
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
    let host = request.host.as_deref().filter(|host| is_own(host, local)).ok_or(Refusal::Host)?;
    let is_same = |origin: &str| origin.strip_prefix("http://") == Some(host);
    if !request.origin.as_deref().is_none_or(is_same) {
        return Err(Refusal::Origin);
    }
    let has_token = || request.token.as_deref().is_some_and(|given| token.is(given));
    let is_this_user = || {
        let own = rustix::process::geteuid().as_raw();
        peer.ip().is_loopback() && uid_of_peer(peer, local).is_some_and(|uid| uid == own || uid == 0)
    };
    let admitted = match need {
        Need::Page => true,
        Need::Data => has_token() || is_this_user(),
        Need::Control => has_token(),
    };
    if admitted { Ok(()) } else { Err(Refusal::Token) }
}

/// Whether `host` is the address at which the connection arrived.
fn is_own(host: &str, local: SocketAddr) -> bool {
    let ip = match local.ip() {
        IpAddr::V6(ip) => ip.to_canonical(),
        ip => ip,
    };
    let port = local.port();
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
    fn only_the_own_address_is_a_host() {
        for host in ["127.0.0.1:7117", "localhost:7117"] {
            assert_eq!(admitted(Need::Page, &request(host, None, None)), Ok(()), "{host}");
        }
        for host in [
            "evil.example:7117",
            "127.0.0.1",
            "127.0.0.1:80",
            "127.0.0.2:7117",
            "localhost",
            "",
            "[::1]:7117",
        ] {
            assert_eq!(admitted(Need::Page, &request(host, None, None)), Err(Refusal::Host), "{host}");
        }
        assert_eq!(admitted(Need::Page, &Request::default()), Err(Refusal::Host));
        assert!(is_own("[::1]:80", "[::1]:80".parse().unwrap()));
        assert!(is_own("192.168.0.7:7117", "[::ffff:192.168.0.7]:7117".parse().unwrap()));
        assert!(!is_own("localhost:7117", "192.168.0.7:7117".parse().unwrap()));
    }

    #[test]
    fn another_origin_is_refused_even_with_the_token() {
        let token = "f".repeat(32);
        for origin in ["http://evil.example", "https://127.0.0.1:7117", "null", "http://127.0.0.1:7118"] {
            let asked = request("127.0.0.1:7117", Some(origin), Some(&token));
            assert_eq!(admitted(Need::Data, &asked), Err(Refusal::Origin), "{origin}");
        }
        let same = request("127.0.0.1:7117", Some("http://127.0.0.1:7117"), Some(&token));
        assert_eq!(admitted(Need::Control, &same), Ok(()));
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
