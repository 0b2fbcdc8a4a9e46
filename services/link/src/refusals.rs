//! Why a connection was refused. Zenoh writes that to its log only and tries again for ever, so its log is read here.
//!
//! Both ends learn it: the one that has connected names the address, the one that listens does not. A text that this does
//! not know is passed on as it is.

use std::collections::BTreeMap;
use std::fmt::{Debug, Write as _};
use std::sync::{Mutex, PoisonError};

use runtime::{Priority, monotonic_ns, print};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

/// Where Zenoh logs that it could not connect, and that it has refused a connection.
const CONNECTING: &str = "zenoh::net::runtime::orchestrator";
const LISTENING: &str = "zenoh_link_commons::quic";
/// Start of the message before the endpoint that could not be connected to.
const CONNECT: &str = "Unable to connect to configured peer ";
/// Start of the message about a connection that was not accepted.
const ACCEPT: &str = "QUIC acceptor failed: ";
/// The same refusal is printed again after this time [ns].
const AGAIN_NS: u64 = 60_000_000_000;
/// A refusal that has not happened again for this long is over [ns].
const OVER_NS: u64 = 3_000_000_000;

/// The refusals of this link, by endpoint; those of an end that listens have none.
static REFUSALS: Mutex<BTreeMap<String, Refusal>> = Mutex::new(BTreeMap::new());

/// The last refusal at one endpoint.
struct Refusal {
    reason: String,
    at_ns: u64,
    printed_ns: u64,
}

/// Takes the messages of Zenoh about connections, from now on.
pub(crate) fn watch() {
    // It can't have been set before.
    let _ = tracing::subscriber::set_global_default(Messages);
}

/// Why the connection to an endpoint is refused now.
pub(crate) fn reason_at(endpoint: &str) -> Option<String> {
    let refusals = REFUSALS.lock().unwrap_or_else(PoisonError::into_inner);
    let refusal = refusals.get(endpoint)?;
    (monotonic_ns().saturating_sub(refusal.at_ns) < OVER_NS).then(|| refusal.reason.clone())
}

/// Notes a refusal, and prints it unless it was printed a moment ago.
fn note(endpoint: &str, reason: String) {
    let now_ns = monotonic_ns();
    let mut refusals = REFUSALS.lock().unwrap_or_else(PoisonError::into_inner);
    let before = refusals.get(endpoint).filter(|before| before.reason == reason);
    let printed_ns = before.map(|before| before.printed_ns);
    let is_new = printed_ns.is_none_or(|printed_ns| now_ns.saturating_sub(printed_ns) > AGAIN_NS);
    if is_new {
        let who = if endpoint.is_empty() { "a peer that has connected" } else { endpoint };
        print(Priority::Warning, &format!("refused: {who}: {reason}"));
    }
    let printed_ns = if is_new { now_ns } else { printed_ns.unwrap_or(now_ns) };
    refusals.insert(endpoint.to_owned(), Refusal { reason, at_ns: now_ns, printed_ns });
}

/// The endpoint of a message of Zenoh, empty where it names none, and why that was refused; `None` for other messages, and
/// where nothing answers.
fn refusal_of(message: &str) -> Option<(&str, String)> {
    if let Some(text) = message.strip_prefix(CONNECT) {
        let (endpoint, text) = text.split_once("! ")?;
        return Some((endpoint, reason_of(text)?));
    }
    Some(("", reason_of(message.strip_prefix(ACCEPT)?)?))
}

/// The reason in the words of a user; `None` when it is none for a refusal.
fn reason_of(text: &str) -> Option<String> {
    // Behind it stands a place in the source of Zenoh.
    let text = text.split(" at /").next()?;
    if !["handshake", "certificate", "crypto("].iter().any(|word| text.contains(word)) {
        return None;
    }
    let whose = match ["ConnectionClosed", "aborted by peer"].iter().any(|word| text.contains(word)) {
        true => "it does not accept the certificate of this host",
        false => "its certificate is not accepted",
    };
    let has = |words: &[&str]| words.iter().any(|word| text.contains(word));
    let why = if has(&["BadSignature", "UnknownIssuer", "UnknownCA", "error 48", "crypto(30)"]) {
        "another authority has signed it; both need certificates of one `scanloop agent pair` folder"
    } else if has(&["xpired", "error 45", "crypto(2d)"]) {
        "it has expired; make another with `scanloop agent pair`"
    } else if has(&["NotValidYet", "not valid yet"]) {
        "it is not valid yet; compare the times of day of both hosts"
    } else if has(&["NotValidForName", "not valid for name"]) {
        "it is for another name or address than the one of the system file"
    } else if has(&["peer sent no certificates", "NoCertificatesPresented", "error 116", "crypto(74)"]) {
        "there is none; the transport quic needs `credentials`"
    } else {
        return Some(format!("{whose}: {text}"));
    };
    Some(format!("{whose}: {why}"))
}

/// Takes messages of Zenoh about connections only.
struct Messages;

impl Subscriber for Messages {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_event() && (metadata.target() == CONNECTING || metadata.target().starts_with(LISTENING))
    }

    fn event(&self, event: &Event<'_>) {
        let mut text = Text(String::new());
        event.record(&mut text);
        if let Some((endpoint, reason)) = refusal_of(&text.0) {
            note(endpoint, reason);
        }
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// The text of a message.
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            let _ = write!(self.0, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_zenoh_logs_is_told_in_the_words_of_a_user() {
        let place = " at /source/of/zenoh.rs:602.";
        let connecting = |error: &str| {
            format!(
                "{CONNECT}quic/10.9.0.2:7411?rel=0! Can not create a new QUIC link bound to 10.9.0.2: {error}{place}"
            )
        };
        let failed = "the cryptographic handshake failed: error";
        for (error, whose, why) in [
            (
                format!("{failed} 51: invalid peer certificate: BadSignature"),
                "its certificate",
                "another authority",
            ),
            (
                format!(
                    "{failed} 45: invalid peer certificate: certificate expired: verified at time 1800000000 (UNIX), but \
                     certificate is not valid after 1790000000 (10000000 seconds ago)"
                ),
                "its certificate",
                "it has expired",
            ),
            (
                format!("aborted by peer: {failed} 48"),
                "it does not accept the certificate of this host",
                "another auth",
            ),
            (
                format!("aborted by peer: {failed} 45"),
                "it does not accept the certificate of this host",
                "has expired",
            ),
            (
                format!("aborted by peer: {failed} 116"),
                "it does not accept the certificate of this host",
                "there is none",
            ),
            (format!("{failed} 46: certificate_unknown"), "its certificate is not accepted", "error 46"),
        ] {
            let message = connecting(&error);
            let (endpoint, reason) = refusal_of(&message).unwrap();
            assert_eq!(endpoint, "quic/10.9.0.2:7411?rel=0");
            assert!(
                reason.starts_with(whose) && reason.contains(why) && !reason.contains("/source"),
                "{reason}"
            );
        }
        let accepted = format!(
            "{ACCEPT}ConnectionClosed(ConnectionClose {{ error_code: Code::crypto(33), frame_type: None, reason: \
             b\"invalid peer certificate: BadSignature\" }}){place} Hint: increase the system open file limit."
        );
        let (endpoint, reason) = refusal_of(&accepted).unwrap();
        assert!(
            endpoint.is_empty() && reason.contains("not accept the certificate of this host: another"),
            "{reason}"
        );
        let none = format!(
            "{ACCEPT}TransportError(Error {{ code: Code::crypto(74), reason: \"peer sent no certificates\" }}){place}"
        );
        assert_eq!(
            refusal_of(&none).unwrap().1,
            "its certificate is not accepted: there is none; the transport quic needs `credentials`"
        );
    }

    #[test]
    fn where_nothing_answers_nothing_is_refused() {
        for message in [
            format!(
                "{CONNECT}quic/10.9.0.2:7411?rel=0! Can not create a new QUIC link bound to 10.9.0.2: timed out at /s:1."
            ),
            format!("{ACCEPT}TimedOut at /s:2."),
            "Loading user-generated certificates.".to_owned(),
        ] {
            assert_eq!(refusal_of(&message), None, "{message}");
        }
    }
}
