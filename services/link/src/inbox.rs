//! Passes on what comes from the network, by its name.
//!
//! There is one subscription for all names. Zenoh tells the other end once what is subscribed to, also over a transport
//! that loses datagrams: with a subscription per topic one of a hundred never came to be where one datagram of a hundred
//! is lost. If the one is lost nothing comes, which is noticed ([`crate::control`]).

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use runtime::monotonic_ns;

type Call = Box<dyn FnMut(&str, &[u8]) + Send>;

/// What is called for which names.
#[derive(Clone, Default)]
pub(crate) struct Inbox(Arc<Shared>);

#[derive(Default)]
struct Shared {
    readers: RwLock<Vec<Reader>>,
    next: AtomicU64,
    /// When something came last [ns].
    heard_ns: AtomicU64,
}

struct Reader {
    id: u64,
    pattern: String,
    call: Mutex<Call>,
}

/// A reader; it is not called any more once this is dropped.
pub(crate) struct Registration {
    id: u64,
    inbox: Inbox,
}

impl Inbox {
    /// Calls `each` with the name and the bytes of all whose name fits the pattern, where `*` stands for any part of a name.
    /// It must not add readers itself.
    pub(crate) fn add(
        &self,
        pattern: String,
        each: impl FnMut(&str, &[u8]) + Send + 'static,
    ) -> Registration {
        let id = self.0.next.fetch_add(1, Ordering::Relaxed);
        let reader = Reader { id, pattern, call: Mutex::new(Box::new(each)) };
        self.0.readers.write().unwrap_or_else(PoisonError::into_inner).push(reader);
        Registration { id, inbox: self.clone() }
    }

    /// Passes on what came under a name.
    pub(crate) fn take(&self, name: &str, bytes: &[u8]) {
        self.0.heard_ns.store(monotonic_ns(), Ordering::Relaxed);
        let readers = self.0.readers.read().unwrap_or_else(PoisonError::into_inner);
        for reader in readers.iter().filter(|reader| fits(&reader.pattern, name)) {
            reader.call.lock().unwrap_or_else(PoisonError::into_inner)(name, bytes);
        }
    }

    /// When something came last [ns]; 0 before.
    pub(crate) fn heard_ns(&self) -> u64 {
        self.0.heard_ns.load(Ordering::Relaxed)
    }
}

impl Drop for Registration {
    fn drop(&mut self) {
        let mut readers = self.inbox.0.readers.write().unwrap_or_else(PoisonError::into_inner);
        readers.retain(|reader| reader.id != self.id);
    }
}

fn fits(pattern: &str, name: &str) -> bool {
    let (mut wanted, mut parts) = (pattern.split('/'), name.split('/'));
    loop {
        match (wanted.next(), parts.next()) {
            (None, None) => return true,
            (Some(wanted), Some(part)) if wanted == "*" || wanted == part => {}
            _ => return false,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn what_comes_is_passed_on_by_its_name() {
        let (inbox, (into, came)) = (Inbox::default(), channel());
        let into_one = into.clone();
        let one = inbox.add("run/topic/*/lab".to_owned(), move |name, bytes| {
            into_one.send((name.to_owned(), bytes.to_vec())).unwrap();
        });
        let _all =
            inbox.add("run/*".to_owned(), move |name, _| into.send((name.to_owned(), vec![])).unwrap());
        for name in ["run/topic/pose/lab", "run/topic/pose/bot", "run/topic/pose", "run/status", "run"] {
            inbox.take(name, &[7]);
        }
        drop(one);
        inbox.take("run/topic/scan/lab", &[8]);
        let expected = [("run/topic/pose/lab".to_owned(), vec![7]), ("run/status".to_owned(), vec![])];
        assert_eq!(came.try_iter().collect::<Vec<_>>(), expected);
        assert!(inbox.heard_ns() > 0);
    }
}
