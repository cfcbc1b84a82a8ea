//! Which requests are answered at all. Nothing that another web page makes a browser send gets through.
//!
//! A browser names the page's own address in `Host` and the page that asks in `Origin`. A foreign page cannot forge
//! either: so `Host` must be an address of this server (a name that an attacker points at 127.0.0.1, DNS rebinding, is not), and
//! `Origin`, where there is one, must be the same. Programs that are no browsers send no `Origin`. Beyond this
//! computer a token is asked for as well.

use super::control::same;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use thiserror::Error;

/// Shortest token that is taken.
pub const TOKEN_LENGTH: usize = 16;

/// What a request says of itself, from its headers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Request<'a> {
    /// `Host`.
    pub host: Option<&'a str>,
    /// `Origin`.
    pub origin: Option<&'a str>,
    /// `Sec-Fetch-Site`, which browsers add.
    pub site: Option<&'a str>,
    /// The token: `Authorization: Bearer`, the cookie, or the page's address.
    pub token: Option<&'a str>,
}

/// Why a request is not answered.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Refused {
    /// `Host` is missing or no address of this server.
    #[error(
        "this server is not called that: open it by its address as `parfocal serve` printed it, or start it with --name for another name"
    )]
    Host,
    /// Another web page asks.
    #[error("another web page asked; only the operator page itself may")]
    Origin,
    /// No token, or a wrong one.
    #[error(
        "the token is missing or wrong: open the address that `parfocal serve` printed, or send it as 'Authorization: Bearer TOKEN'"
    )]
    Token,
}

/// Why the server does not start.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Unsafe {
    /// Reachable from elsewhere, without a token.
    #[error(
        "{0} can be reached from other computers, and whoever reaches it can move the stage: give a --token, for instance --token {1}"
    )]
    NoToken(SocketAddr, String),
    /// A token that can be guessed.
    #[error("the token is too short: at least {TOKEN_LENGTH} letters or digits, for instance --token {0}")]
    Short(String),
    /// A token that no header carries.
    #[error("the token may hold letters, digits, - and _ only, for instance --token {0}")]
    Letters(String),
}

/// Rules for one listening address.
#[derive(Clone, Debug)]
pub struct Rules {
    port: u16,
    loopback: bool,
    token: Option<String>,
    names: Vec<String>,
}

/// A token of 128 random bits.
pub fn random_token() -> String {
    format!("{:032x}", rand::random::<u128>())
}

impl Rules {
    /// Rules for a server at `listen`, which may also be called `names`.
    ///
    /// # Errors
    /// [`Unsafe`], with what to write instead.
    pub fn new(listen: SocketAddr, token: Option<String>, names: Vec<String>) -> Result<Self, Unsafe> {
        let loopback = listen.ip().is_loopback();
        match &token {
            None if !loopback => return Err(Unsafe::NoToken(listen, random_token())),
            Some(token) if token.len() < TOKEN_LENGTH => return Err(Unsafe::Short(random_token())),
            Some(token) if !token.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_') => {
                return Err(Unsafe::Letters(random_token()));
            }
            _ => {}
        }
        Ok(Self { port: listen.port(), loopback, token, names })
    }

    /// The token, if one is asked for.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Judges a request by its headers.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn judge(&self, request: &Request<'_>) -> Result<(), Refused> {
        let host = request.host.filter(|host| self.is_own(host)).ok_or(Refused::Host)?;
        if let Some(origin) = request.origin
            && origin.strip_prefix("http://").is_none_or(|origin| !origin.eq_ignore_ascii_case(host))
        {
            return Err(Refused::Origin);
        }
        // `none`: typed by the person. `same-site` would be another port of this computer.
        if request.site.is_some_and(|site| site != "same-origin" && site != "none") {
            return Err(Refused::Origin);
        }
        match &self.token {
            Some(token) if !request.token.is_some_and(|given| same(token, given)) => Err(Refused::Token),
            _ => Ok(()),
        }
    }

    /// Whether a `Host` header is an address of this server.
    fn is_own(&self, host: &str) -> bool {
        let (name, port) = match host.rsplit_once(':') {
            // The colon of an IPv6 address without a port.
            Some((_, rest)) if rest.ends_with(']') => (host, "80"),
            Some((name, port)) => (name, port),
            None => (host, "80"),
        };
        if port.parse() != Ok(self.port) {
            return false;
        }
        let ip = name.parse::<Ipv4Addr>().ok().map(IpAddr::V4).or_else(|| {
            let inside = name.strip_prefix('[')?.strip_suffix(']')?;
            inside.parse::<Ipv6Addr>().ok().map(IpAddr::V6)
        });
        let named = |own: &str| name.eq_ignore_ascii_case(own);
        match ip {
            Some(ip) => !self.loopback || ip.is_loopback(),
            None => named("localhost") || self.names.iter().any(|own| named(own)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules() -> Rules {
        Rules::new("127.0.0.1:8321".parse().unwrap(), None, Vec::new()).unwrap()
    }

    fn ask(host: &'static str, origin: Option<&'static str>) -> Request<'static> {
        Request { host: Some(host), origin, ..Request::default() }
    }

    #[test]
    fn only_this_server_by_its_own_address_is_answered() {
        for host in ["127.0.0.1:8321", "localhost:8321", "[::1]:8321", "LOCALHOST:8321"] {
            assert_eq!(rules().judge(&ask(host, None)), Ok(()), "{host}");
        }
        for host in
            ["evil.example:8321", "127.0.0.1", "127.0.0.1:80", "192.168.1.5:8321", "localhost.evil.example:8321", ""]
        {
            assert_eq!(rules().judge(&ask(host, None)), Err(Refused::Host), "{host}");
        }
        assert_eq!(rules().judge(&Request::default()), Err(Refused::Host));
    }

    #[test]
    fn other_pages_are_refused_even_on_this_computer() {
        let own = "http://127.0.0.1:8321";
        assert_eq!(rules().judge(&ask("127.0.0.1:8321", Some(own))), Ok(()));
        for origin in
            ["http://evil.example", "null", "https://127.0.0.1:8321", "http://localhost:8321", "http://127.0.0.1:9"]
        {
            assert_eq!(rules().judge(&ask("127.0.0.1:8321", Some(origin))), Err(Refused::Origin), "{origin}");
        }
        for (site, answer) in [("none", Ok(())), ("same-origin", Ok(())), ("cross-site", Err(Refused::Origin))] {
            let request = Request { site: Some(site), ..ask("127.0.0.1:8321", None) };
            assert_eq!(rules().judge(&request), answer);
        }
    }

    #[test]
    fn beyond_this_computer_a_token_is_asked_for() {
        let outside: SocketAddr = "0.0.0.0:8321".parse().unwrap();
        assert!(matches!(Rules::new(outside, None, Vec::new()), Err(Unsafe::NoToken(..))));
        assert!(matches!(Rules::new(outside, Some("short".into()), Vec::new()), Err(Unsafe::Short(_))));
        assert!(matches!(Rules::new(outside, Some("0123456789abcdef;".into()), Vec::new()), Err(Unsafe::Letters(_))));
        let token = "0123456789abcdef";
        let rules = Rules::new(outside, Some(token.into()), vec!["scope.lab".into()]).unwrap();
        for host in ["10.0.0.7:8321", "scope.lab:8321"] {
            let with = |token| rules.judge(&Request { host: Some(host), token, ..Request::default() });
            assert_eq!(with(Some(token)), Ok(()));
            assert_eq!(with(Some("0123456789abcdee")), Err(Refused::Token));
            assert_eq!(with(None), Err(Refused::Token));
        }
        assert_eq!(rules.judge(&ask("evil.example:8321", None)), Err(Refused::Host));
        assert!(Rules::new("127.0.0.2:99".parse().unwrap(), None, Vec::new()).is_ok());
    }
}
