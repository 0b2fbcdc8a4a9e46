//! `agent.toml`: where an agent listens, and what it may start.

use std::net::SocketAddr;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use plan::hosts::Transport;
use supervision::entry::IMPLEMENTATIONS;
use vehicle::{Invalid, parse, read, settings};

settings! {
    /// A checked agent file.
    pub struct AgentFile {
        /// Name of this host, as `[[host]]` of the system file has it.
        pub name: String = String::new(), "must be given";
        /// Address and port at which the agent listens; it listens nowhere else.
        pub listen: String = String::new(), "an IP address of this machine and a port, must be given";
        /// What samples travel with, as `[[host]]` of the system file has it.
        pub transport: Transport = Transport::Quic;
        /// Folder with the certificates of this host, for transport `quic`; `scanloop agent pair` makes it.
        pub credentials: Option<String> = None, "a folder";
        /// Built-in implementations that an orchestrator may have started here.
        pub implementations: Vec<String> = Vec::new(), "emulator, player, ros2, ekf, ellipses, nmpc, actuation";
    }
}

impl AgentFile {
    /// Reads a file that only its owner may read and write: it decides what others may start here.
    ///
    /// # Errors
    /// One message with file, key and value; exit code 2.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display().to_string();
        let refuse = |reason: String| Failure::bad_input(format!("{name}: {reason}"));
        let text = user_file::read(path, TEXT_BYTES).map_err(|error| refuse(error.to_string()))?;
        let meta = std::fs::metadata(path).map_err(|error| refuse(error.to_string()))?;
        let own = rustix::process::geteuid().as_raw();
        if meta.uid() != own {
            return Err(refuse(format!(
                "its owner is user {}, not user {own} who runs the agent",
                meta.uid()
            )));
        }
        if meta.mode() & 0o077 != 0 {
            let mode = meta.mode() & 0o777;
            return Err(refuse(format!(
                "mode {mode:o} is not allowed: 600; only its owner may read and write it"
            )));
        }
        let file: Self =
            read(parse(&text).map_err(refuse)?).map_err(|invalid| refuse(invalid.to_string()))?;
        file.validate().map_err(|invalid| refuse(invalid.to_string()))?;
        Ok(file)
    }

    /// Where it listens, as Zenoh writes it.
    pub fn endpoint(&self) -> String {
        plan::hosts::endpoint(self.transport, &self.listen)
    }

    fn validate(&self) -> Result<(), Invalid> {
        let given = |text: &str| if text.is_empty() { "(missing)".to_owned() } else { text.to_owned() };
        if !plan::hosts::is_name(&self.name) {
            return Err(Invalid::new("name", given(&self.name), plan::hosts::NAME_RULE));
        }
        let address = self.listen.parse::<SocketAddr>().ok();
        if address.is_none_or(|address| address.port() == 0 || address.ip().is_unspecified()) {
            return Err(Invalid::new("listen", given(&self.listen), plan::hosts::ADDRESS_RULE));
        }
        plan::hosts::require_credentials(self.transport, self.credentials.as_deref())?;
        let allowed: Vec<&str> = IMPLEMENTATIONS.iter().map(|(name, _)| *name).collect();
        match self.implementations.iter().find(|name| !allowed.contains(&name.as_str())) {
            Some(name) => {
                Err(Invalid::new("implementations", name, format!("some of {}", allowed.join(", "))))
            }
            None if self.implementations.is_empty() => {
                Err(Invalid::new("implementations", "[]", format!("some of {}", allowed.join(", "))))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    const GOOD: &str =
        "name = \"lab\"\nlisten = \"127.0.0.1:7411\"\ntransport = \"udp\"\nimplementations = [\"nmpc\"]\n";

    fn read_as(text: &str, mode: u32) -> anyhow::Result<AgentFile> {
        let path =
            std::env::temp_dir().join(format!("agent-{}-{mode:o}-{}.toml", std::process::id(), text.len()));
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        let read = AgentFile::read(&path);
        std::fs::remove_file(&path).unwrap();
        read
    }

    #[test]
    fn a_file_that_others_can_read_is_refused() {
        let file = read_as(GOOD, 0o600).unwrap();
        assert_eq!(file.endpoint(), "udp/127.0.0.1:7411?rel=0");
        let message = read_as(GOOD, 0o640).unwrap_err().to_string();
        assert!(message.contains("mode 640 is not allowed: 600"), "{message}");
    }

    #[test]
    fn wrong_values_are_refused_with_file_key_and_value() {
        let refusal = |from: &str, to: &str| read_as(&GOOD.replace(from, to), 0o600).unwrap_err().to_string();
        assert!(refusal("lab", "La").contains("name = La is not allowed"));
        assert!(refusal("127.0.0.1", "0.0.0.0").contains("listen = 0.0.0.0:7411 is not allowed"));
        let command = refusal("nmpc", "sh");
        assert!(
            command.ends_with(
                "implementations = sh is not allowed: some of emulator, player, ros2, ekf, ellipses, nmpc, actuation"
            ),
            "{command}"
        );
        assert!(refusal("\"nmpc\"", "").contains("implementations = [] is not allowed"));
        assert!(refusal("udp", "quic").contains("credentials = (missing) is not allowed: a folder"));
        let unknown = refusal("name", "nam");
        assert!(unknown.contains("nam = ") && unknown.contains("the key is unknown"), "{unknown}");
    }
}
