//! Arguments of `view`.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;

use clap::Args;
use console::exit::Failure;

/// The port of the page, unless another one is named.
pub(crate) const DEFAULT_PORT: u16 = 7117;
/// So many connections may wait to be accepted; the kernel allows fewer where `net.core.somaxconn` is smaller. The default of
/// 128 is full within the time slice of another user who connects all the time, and then no other connection gets in.
const BACKLOG: i32 = 4096;

/// Arguments of `view`.
#[derive(Debug, Clone, Args)]
pub struct ViewArguments {
    /// A recording to show; without it the running system.
    #[arg(value_name = "FILE", conflicts_with = "control")]
    pub file: Option<PathBuf>,
    /// Port of the page; 0 takes any free one.
    #[arg(long, value_name = "PORT", default_value_t = DEFAULT_PORT)]
    pub port: u16,
    /// Address to serve the page on; another one than 127.0.0.1 is reachable from other computers.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub listen: IpAddr,
    /// Allow the page to stop, restart and swap, and to change settings; each request needs the token of the printed link.
    #[arg(long)]
    pub control: bool,
    /// Serve the page for a run that started this process, on the listening socket at standard input.
    #[arg(long, hide = true)]
    pub for_run: bool,
}

/// Opens the listening socket of the page. Its messages name no option: `view` and `run` have different ones for the port.
///
/// # Errors
/// An address that is in use or is not one of this machine; exit code 2.
pub(crate) fn listen(address: IpAddr, port: u16) -> anyhow::Result<TcpListener> {
    let bound = TcpListener::bind(SocketAddr::new(address, port)).and_then(|listener| {
        // A second call changes nothing but the length of the queue.
        rustix::net::listen(&listener, BACKLOG)?;
        Ok(listener)
    });
    bound.map_err(|error| match error.kind() {
        std::io::ErrorKind::AddrInUse => Failure::bad_input(format!(
            "port {port} of {address} is in use; name another one, or 0 for any free one"
        )),
        std::io::ErrorKind::AddrNotAvailable => Failure::bad_input(format!(
            "--listen {address}: not an address of this machine; allowed: 127.0.0.1, 0.0.0.0 or one of its own"
        )),
        _ => Failure::bad_input(format!("port {port} of {address}: {error}")),
    })
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, TcpStream};
    use std::time::Duration;

    use super::*;

    #[test]
    fn more_connections_wait_than_by_default() {
        let allowed = std::fs::read_to_string("/proc/sys/net/core/somaxconn").unwrap();
        let count = allowed.trim().parse::<usize>().unwrap().min(400);
        let listener = listen(IpAddr::V4(Ipv4Addr::LOCALHOST), 0).unwrap();
        let address = listener.local_addr().unwrap();
        let connect = || TcpStream::connect_timeout(&address, Duration::from_secs(5)).unwrap();
        let waiting: Vec<TcpStream> = (0..count).map(|_| connect()).collect();
        assert_eq!(waiting.len(), count);
    }

    #[test]
    fn a_port_in_use_is_named_without_an_option_that_was_not_written() {
        let address = IpAddr::from([127, 0, 0, 1]);
        let held = listen(address, 0).unwrap();
        let port = held.local_addr().unwrap().port();
        let refused = listen(address, port).unwrap_err().to_string();
        let advice = "name another one, or 0 for any free one";
        assert_eq!(refused, format!("port {port} of 127.0.0.1 is in use; {advice}"));
    }
}
