//! Certificates of hosts: made for a pair of them, and checked before they are used.
//!
//! One authority per system signs a certificate for each host. Its key stays in the folder where pairs are made; a host gets
//! the certificate of the authority, its own certificate, and its own key. A peer whose certificate the authority has not
//! signed, or that has expired, is refused by the handshake of QUIC.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

use anyhow::{Context, bail};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, SanType,
};
use runtime::HUB;
use time::{Duration, OffsetDateTime};

/// Files of a host.
pub(crate) const AUTHORITY: &str = "authority.pem";
pub(crate) const CERTIFICATE: &str = "certificate.pem";
pub(crate) const KEY: &str = "key.pem";
/// File of the key that signs certificates; it is not copied to hosts.
const AUTHORITY_KEY: &str = "authority-key.pem";
/// Clocks of hosts may differ by this.
const BEFORE: Duration = Duration::hours(1);
/// How long the authority is valid; each certificate has its own time within this.
const AUTHORITY_DAYS: i64 = 3650;

/// Makes certificates for the orchestrator and for `host` at `address`, valid for `days`, in folders below `folder`.
///
/// # Errors
/// A folder that can't be written, and an authority in it that can't be read.
pub(crate) fn pair(folder: &Path, host: &str, address: IpAddr, days: i64) -> anyhow::Result<()> {
    make_folder(folder)?;
    let issuer = authority(folder)?;
    let authority_pem = std::fs::read_to_string(folder.join(AUTHORITY))?;
    for (name, address) in [(HUB, None), (host, Some(address))] {
        let mut params = CertificateParams::new(vec![name.to_owned()])?;
        params.subject_alt_names.extend(address.map(SanType::IpAddress));
        params.distinguished_name.push(DnType::CommonName, name);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        params.use_authority_key_identifier_extension = true;
        limit(&mut params, days);
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &issuer)?;
        let own = folder.join(name);
        make_folder(&own)?;
        write(&own.join(AUTHORITY), &authority_pem)?;
        write(&own.join(CERTIFICATE), &certificate.pem())?;
        write(&own.join(KEY), &key.serialize_pem())?;
    }
    Ok(())
}

/// Passes when the certificates of a host are valid now.
///
/// # Errors
/// The file with its value: one that is missing, no certificate, not yet valid or expired.
pub(crate) fn check(folder: &Path) -> anyhow::Result<()> {
    for name in [AUTHORITY, CERTIFICATE] {
        let path = folder.join(name);
        let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
        let (_, pem) = x509_parser::pem::parse_x509_pem(&text).with_context(|| path.display().to_string())?;
        let certificate = pem.parse_x509().with_context(|| path.display().to_string())?;
        let validity = certificate.validity();
        if !validity.is_valid() {
            let (from, until) = (validity.not_before, validity.not_after);
            bail!(
                "{}: it is valid from {from} until {until}, not now; make another with `scanloop agent pair`",
                path.display()
            );
        }
    }
    Ok(())
}

/// The authority of a folder, which is made with the first pair.
fn authority(folder: &Path) -> anyhow::Result<Issuer<'static, KeyPair>> {
    let [certificate, key] = [AUTHORITY, AUTHORITY_KEY].map(|name| folder.join(name));
    let mut params = CertificateParams::new(Vec::<String>::new())?;
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.distinguished_name.push(DnType::CommonName, "scanloop hosts");
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    if key.exists() {
        let pem = std::fs::read_to_string(&key).with_context(|| key.display().to_string())?;
        return Ok(Issuer::new(params, KeyPair::from_pem(&pem).with_context(|| key.display().to_string())?));
    }
    limit(&mut params, AUTHORITY_DAYS);
    let pair = KeyPair::generate()?;
    write(&certificate, &params.self_signed(&pair)?.pem())?;
    write(&key, &pair.serialize_pem())?;
    Ok(Issuer::new(params, pair))
}

fn limit(params: &mut CertificateParams, days: i64) {
    // The only use of the time of the day: certificates count in it.
    let now = OffsetDateTime::now_utc();
    (params.not_before, params.not_after) = (now - BEFORE, now + Duration::days(days));
}

fn make_folder(path: &Path) -> anyhow::Result<()> {
    match std::fs::DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}

/// Writes a file that only its owner may read.
fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let _ = std::fs::remove_file(path);
    let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    written.with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;
    use std::path::PathBuf;

    use super::*;

    fn folder(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("scanloop-pair-{name}-{}", std::process::id()))
    }

    #[test]
    fn certificates_of_a_pair_are_valid_and_keys_are_private() {
        let folder = folder("good");
        let address = "10.9.0.2".parse().unwrap();
        pair(&folder, "lab", address, 7).unwrap();
        let authority = std::fs::read(folder.join(AUTHORITY)).unwrap();
        pair(&folder, "desk", address, 7).unwrap();
        for host in [HUB, "lab", "desk"] {
            check(&folder.join(host)).unwrap();
            assert_eq!(std::fs::read(folder.join(host).join(AUTHORITY)).unwrap(), authority, "{host}");
            let mode = std::fs::metadata(folder.join(host).join(KEY)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        assert!(!folder.join("lab").join(AUTHORITY_KEY).exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn an_expired_certificate_is_named() {
        let folder = folder("expired");
        pair(&folder, "lab", "10.9.0.2".parse().unwrap(), -1).unwrap();
        let message = check(&folder.join("lab")).unwrap_err().to_string();
        assert!(message.contains("lab/certificate.pem: it is valid from"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
