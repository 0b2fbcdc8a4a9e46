//! Log lines of all processes: to standard error, the level by `SCANLOOP_LOG`.

use tracing_subscriber::EnvFilter;

/// Starts logging; `SCANLOOP_LOG` takes levels and targets (`debug`, `nmpc=debug`), the default is `info`.
pub fn start_logging() {
    let filter = EnvFilter::try_from_env("SCANLOOP_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    // A second start, as in tests, keeps the first subscriber.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .without_time()
        .try_init();
}
