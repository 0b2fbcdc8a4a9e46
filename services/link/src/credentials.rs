//! Certificates of hosts: made for a pair of them, and checked before they are used.
//!
//! One authority per system signs a certificate for each host. Its key stays in the folder where pairs are made; a host gets
//! the certificate of the authority, its own certificate, and its own key. A peer whose certificate the authority has not
//! signed, or that has expired, is refused by the handshake of QUIC.
//!
//! A certificate says what its owner may be. That of the orchestrator is one of a client only: it may connect to agents, and
//! none may take it for an agent. That of an agent is one of a server only, with its name and address: it may be connected to
//! at that address, and it may not drive another agent. The handshake refuses everything else.

use std::net::IpAddr;
use std::path::Path;

use anyhow::{Context, bail};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, SanType,
};
use runtime::{Folder, HUB, RuntimeError};
use time::{Duration, OffsetDateTime};
use x509_parser::certificate::X509Certificate;
use x509_parser::pem::Pem;
use x509_parser::public_key::PublicKey;

use crate::network::{AUTHORITY, CERTIFICATE, KEY};

/// File of the key that signs certificates; it is not copied to hosts.
const AUTHORITY_KEY: &str = "authority-key.pem";
/// Clocks of hosts may differ by this.
const BEFORE: Duration = Duration::hours(1);
/// How long the authority is valid; each certificate has its own time within this.
const AUTHORITY_DAYS: i64 = 3650;

/// Makes certificates for the orchestrator and for `host` at `address`, valid for `days`, in folders below `folder`. What the
/// orchestrator has, and is still valid, stays.
///
/// # Errors
/// A folder that is not private or can't be written, an authority in it that can't be read, and a host that has a certificate
/// already, unless `force`.
pub(crate) fn pair(folder: &Path, host: &str, address: IpAddr, days: i64, force: bool) -> anyhow::Result<()> {
    // Another one may make it at the same time.
    let make = || Folder::make(folder).or_else(|error| Folder::open(folder).ok().flatten().ok_or(error));
    let all = open(folder)?.map_or_else(make, Ok)?;
    // Two at a time would make two authorities.
    let alone = std::fs::File::open(all.by_descriptor("."))?;
    alone.lock()?;
    if !force && all.contains(host) {
        bail!(
            "{}: the host has been paired already; name another folder, or replace its key with --force",
            folder.join(host).display()
        );
    }
    let issuer = authority(&all)?;
    let authority_pem = all.read_text(AUTHORITY)?;
    for (name, address) in [(HUB, None), (host, Some(address))] {
        if name == HUB && !force && check(&folder.join(HUB), HUB).is_ok() {
            continue;
        }
        let mut params = CertificateParams::new(vec![name.to_owned()])?;
        params.subject_alt_names.extend(address.map(SanType::IpAddress));
        params.distinguished_name.push(DnType::CommonName, name);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![match name {
            HUB => ExtendedKeyUsagePurpose::ClientAuth,
            _ => ExtendedKeyUsagePurpose::ServerAuth,
        }];
        params.use_authority_key_identifier_extension = true;
        limit(&mut params, days);
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &issuer)?;
        let own = all.folder(name).map_err(not_private)?.map_or_else(|| all.make_folder(name), Ok)?;
        write(&own, AUTHORITY, &authority_pem)?;
        write(&own, CERTIFICATE, &certificate.pem())?;
        write(&own, KEY, &key.serialize_pem())?;
    }
    Ok(())
}

/// Passes when the certificates of a host are valid now, are for that host and of its key and authority, and are in a private
/// folder.
///
/// # Errors
/// A folder that is not private, and the file with its value: one that is missing, is no certificate or key, is for another
/// host or purpose, is not yet valid or expired, or does not belong to the others.
pub(crate) fn check(folder: &Path, host: &str) -> anyhow::Result<()> {
    if open(folder)?.is_none() {
        bail!("{}: there is no such folder", folder.display());
    }
    let [authority, certificate, key] = [AUTHORITY, CERTIFICATE, KEY].map(|name| {
        let path = folder.join(name);
        read_pem(&path).with_context(|| path.display().to_string())
    });
    let [authority, certificate, key] = [authority?, certificate?, key?];
    for (name, pem) in [(AUTHORITY, &authority), (CERTIFICATE, &certificate)] {
        let named = || folder.join(name).display().to_string();
        let certificate = pem[0].parse_x509().with_context(named)?;
        if name == CERTIFICATE {
            is_for(&certificate, host).with_context(named)?;
        }
        let validity = certificate.validity();
        if !validity.is_valid() {
            let (from, until) = (validity.not_before, validity.not_after);
            bail!(
                "{}: it is valid from {from} until {until}, not now; make another with `scanloop agent pair`",
                named()
            );
        }
    }
    let own = certificate[0].parse_x509()?;
    is_key_of(&key, &own).with_context(|| folder.join(KEY).display().to_string())?;
    // A certificate may come with those of authorities between.
    let mut signers = authority.iter().chain(&certificate[1..]).filter_map(|pem| pem.parse_x509().ok());
    if !signers.any(|signer| own.verify_signature(Some(signer.public_key())).is_ok()) {
        bail!(
            "{}: this authority has not signed {CERTIFICATE}; copy all files of the host from one `scanloop agent pair` folder",
            folder.join(AUTHORITY).display()
        );
    }
    Ok(())
}

/// The parts of a file in PEM, at least one.
fn read_pem(path: &Path) -> anyhow::Result<Vec<Pem>> {
    let text = std::fs::read(path)?;
    match text.as_slice() {
        [] => bail!("it is empty"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [b'-', 0, ..] | [0, b'-', ..] => {
            bail!("it is a text in UTF-16; save it as ASCII")
        }
        [0xef, 0xbb, 0xbf, ..] => bail!("it begins with a byte order mark; save it as ASCII without one"),
        _ => {}
    }
    let parts: Vec<Pem> = Pem::iter_from_buffer(&text).collect::<Result<_, _>>()?;
    if parts.is_empty() {
        bail!("it has no line `-----BEGIN ...-----`");
    }
    Ok(parts)
}

/// Passes when a file has the private key of a certificate. Before it may stand the parameters of its curve, as OpenSSL writes
/// them; a key in the form of SEC 1 or PKCS #1 contains what is public of it.
fn is_key_of(parts: &[Pem], certificate: &X509Certificate<'_>) -> anyhow::Result<()> {
    let Some(key) = parts.iter().find(|part| part.label.ends_with("PRIVATE KEY")) else {
        bail!("it is a {}, no private key", parts[0].label);
    };
    let public = certificate.public_key();
    let raw = public.subject_public_key.data.as_ref();
    let contains = |part: &[u8]| key.contents.windows(part.len().max(1)).any(|bytes| bytes == part);
    let is_of_certificate = match key.label.as_str() {
        "PRIVATE KEY" => KeyPair::try_from(key.contents.as_slice())?.public_key_raw() == raw,
        "EC PRIVATE KEY" => contains(raw),
        "RSA PRIVATE KEY" => matches!(public.parsed()?, PublicKey::RSA(rsa) if contains(rsa.modulus)),
        label => bail!("it is a key in the form {label}; save it without a password, as PRIVATE KEY"),
    };
    if !is_of_certificate {
        bail!(
            "it is the key of another certificate than {CERTIFICATE}; copy both from one `scanloop agent pair` folder"
        );
    }
    Ok(())
}

/// Passes when a certificate is one of this host, as a client or a server as that host needs it.
fn is_for(certificate: &X509Certificate<'_>, host: &str) -> anyhow::Result<()> {
    let subject = certificate.subject().iter_common_name().find_map(|name| name.as_str().ok());
    let subject = subject.unwrap_or("(no name)");
    let usage = certificate.extended_key_usage()?.map(|found| found.value);
    let (client, server) = usage.map_or((false, false), |usage| (usage.client_auth, usage.server_auth));
    let what = if host == HUB { "the orchestrator" } else { "this agent" };
    if subject != host {
        bail!("it is the certificate of {subject}, {what} needs that of {host}");
    }
    if (client, server) != (host == HUB, host != HUB) {
        bail!(
            "it does not say that it is for {what} only, as of a version before; make all of them again in a new folder with \
             `scanloop agent pair`"
        );
    }
    Ok(())
}

/// The authority of a folder, which is made with the first pair.
fn authority(folder: &Folder) -> anyhow::Result<Issuer<'static, KeyPair>> {
    let mut params = CertificateParams::new(Vec::<String>::new())?;
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.distinguished_name.push(DnType::CommonName, "scanloop hosts");
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    if folder.contains(AUTHORITY_KEY) {
        let name = || folder.path().join(AUTHORITY_KEY).display().to_string();
        let key = KeyPair::from_pem(&folder.read_text(AUTHORITY_KEY)?).with_context(name)?;
        return Ok(Issuer::new(params, key));
    }
    if folder.contains(AUTHORITY) {
        bail!(
            "{}: there is no {AUTHORITY_KEY} with it, so it is what a host trusts, or its key is kept elsewhere; put the key \
             there, or name another folder",
            folder.path().join(AUTHORITY).display()
        );
    }
    limit(&mut params, AUTHORITY_DAYS);
    let pair = KeyPair::generate()?;
    write(folder, AUTHORITY, &params.self_signed(&pair)?.pem())?;
    write(folder, AUTHORITY_KEY, &pair.serialize_pem())?;
    Ok(Issuer::new(params, pair))
}

fn limit(params: &mut CertificateParams, days: i64) {
    // The only use of the time of the day: certificates count in it.
    let now = OffsetDateTime::now_utc();
    (params.not_before, params.not_after) = (now - BEFORE, now + Duration::days(days));
}

/// A folder of keys, as private as those of running systems are; `None` where there is none.
fn open(folder: &Path) -> anyhow::Result<Option<Folder>> {
    Folder::open(folder).map_err(not_private)
}

/// The folders of running systems have a variable that names another place; those of keys are named by the user.
fn not_private(error: RuntimeError) -> anyhow::Error {
    match error {
        RuntimeError::NotPrivate { path, reason } => anyhow::anyhow!(
            "{} {reason}; it has to be a directory of this user with mode 0700: change it, or name another one",
            path.display()
        ),
        error => error.into(),
    }
}

/// Writes a file that only its owner may read, and syncs it: with a lost key a host can not be reached.
fn write(folder: &Folder, name: &str, text: &str) -> anyhow::Result<()> {
    folder.write(name, text.as_bytes())?;
    let synced = std::fs::File::open(folder.by_descriptor(name)).and_then(|file| file.sync_all());
    synced.with_context(|| folder.path().join(name).display().to_string())
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
        pair(&folder, "lab", address, 7, false).unwrap();
        let contents =
            || [AUTHORITY, "orchestrator/key.pem"].map(|name| std::fs::read(folder.join(name)).unwrap());
        let before = contents();
        pair(&folder, "desk", address, 7, false).unwrap();
        assert!(contents() == before, "authority and orchestrator keep their keys");
        let [authority, _] = before;
        for host in [HUB, "lab", "desk"] {
            check(&folder.join(host), host).unwrap();
            assert_eq!(std::fs::read(folder.join(host).join(AUTHORITY)).unwrap(), authority, "{host}");
            let mode = std::fs::metadata(folder.join(host).join(KEY)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        assert!(!folder.join("lab").join(AUTHORITY_KEY).exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_host_keeps_its_key_and_a_folder_that_others_can_enter_is_refused() {
        let folder = folder("again");
        let address = "10.9.0.2".parse().unwrap();
        pair(&folder, "lab", address, 7, false).unwrap();
        let key = || std::fs::read(folder.join("lab").join(KEY)).unwrap();
        let before = key();
        let message = pair(&folder, "lab", address, 7, false).unwrap_err().to_string();
        assert!(message.contains("lab: the host has been paired already"), "{message}");
        assert!(key() == before);
        pair(&folder, "lab", address, 7, true).unwrap();
        assert!(key() != before);
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o755)).unwrap();
        let message = pair(&folder, "desk", address, 7, true).unwrap_err().to_string();
        assert!(message.contains("has mode 0755 instead of 0700"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_a_host_trusts_is_not_replaced_where_the_key_of_the_authority_is_not_there() {
        let folder = folder("apart");
        let address = "10.9.0.2".parse().unwrap();
        pair(&folder, "lab", address, 7, false).unwrap();
        let of_lab = folder.join("lab");
        let before = std::fs::read(of_lab.join(AUTHORITY)).unwrap();
        for force in [false, true] {
            let message = pair(&of_lab, "desk", address, 7, force).unwrap_err().to_string();
            assert!(message.contains("lab/authority.pem: there is no authority-key.pem"), "{message}");
        }
        assert!(std::fs::read(of_lab.join(AUTHORITY)).unwrap() == before);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn pairs_that_are_made_at_the_same_time_have_one_authority() {
        let folder = folder("at-once");
        let hosts = ["a", "b", "c", "d"];
        std::thread::scope(|scope| {
            for host in hosts {
                scope.spawn(|| pair(&folder, host, "10.9.0.2".parse().unwrap(), 7, false).unwrap());
            }
        });
        hosts.iter().chain(&[HUB]).for_each(|host| check(&folder.join(host), host).unwrap());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_certificate_is_for_one_host_and_one_role() {
        let folder = folder("roles");
        for host in ["lab", "desk"] {
            pair(&folder, host, "10.9.0.2".parse().unwrap(), 7, false).unwrap();
        }
        for (own, other) in [("desk", HUB), ("desk", "lab"), (HUB, "lab")] {
            let message = format!("{:#}", check(&folder.join(own), other).unwrap_err());
            assert!(message.contains(&format!("it is the certificate of {own}")), "{message}");
        }
        let pem = std::fs::read(folder.join("lab").join(CERTIFICATE)).unwrap();
        let (_, pem) = x509_parser::pem::parse_x509_pem(&pem).unwrap();
        let certificate = pem.parse_x509().unwrap();
        let usage = certificate.extended_key_usage().unwrap().unwrap().value;
        assert!(usage.server_auth && !usage.client_auth, "an agent can't connect as an orchestrator");
        std::fs::set_permissions(folder.join("lab"), std::fs::Permissions::from_mode(0o777)).unwrap();
        let message = format!("{:#}", check(&folder.join("lab"), "lab").unwrap_err());
        assert!(message.contains("0777"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn files_that_do_not_belong_together_or_are_of_other_editors_are_named() {
        let folder = folder("files");
        let other = self::folder("files-other");
        let address = "10.9.0.2".parse().unwrap();
        pair(&folder, "lab", address, 7, false).unwrap();
        pair(&other, "lab", address, 7, false).unwrap();
        let file = |name: &str| folder.join("lab").join(name);
        let refused = |name: &str, bytes: &[u8]| {
            let good = std::fs::read(file(name)).unwrap();
            std::fs::write(file(name), bytes).unwrap();
            let message = format!("{:#}", check(&folder.join("lab"), "lab").unwrap_err());
            std::fs::write(file(name), good).unwrap();
            assert!(message.starts_with(&format!("{}: ", file(name).display())), "{message}");
            message
        };
        for name in [AUTHORITY, CERTIFICATE, KEY] {
            let text = std::fs::read_to_string(file(name)).unwrap();
            let utf_16 = |mark: &str| -> Vec<u8> {
                [mark, &text].concat().encode_utf16().flat_map(u16::to_le_bytes).collect()
            };
            for (bytes, expected) in [
                (utf_16("\u{feff}"), "UTF-16"),
                (utf_16(""), "UTF-16"),
                (["\u{feff}", &text].concat().into_bytes(), "byte order mark"),
                (Vec::new(), "it is empty"),
                (b"secret\n".to_vec(), ""),
                (text.as_bytes()[..text.len() / 2].to_vec(), ""),
            ] {
                let message = refused(name, &bytes);
                assert!(message.contains(expected), "{message}");
            }
        }
        let of_other = |name: &str| std::fs::read(other.join("lab").join(name)).unwrap();
        assert!(refused(KEY, &of_other(KEY)).contains("the key of another certificate"));
        assert!(refused(KEY, &of_other(CERTIFICATE)).contains("it is a CERTIFICATE, no private key"));
        // The form that OpenSSL writes for a curve: its parameters, and the inner part of the key with what is public of it.
        let sec_1 = |name: &Path| {
            let key = read_pem(&name.join(KEY)).unwrap().remove(0).contents;
            let at = key.windows(5).position(|bytes| bytes == [2, 1, 1, 4, 32]).unwrap() - 2;
            let pem =
                |label: &str, contents: &[u8]| Pem { label: label.to_owned(), contents: contents.to_vec() };
            [pem("EC PARAMETERS", b""), pem("EC PRIVATE KEY", &key[at..])]
        };
        let certificate = read_pem(&file(CERTIFICATE)).unwrap();
        let certificate = certificate[0].parse_x509().unwrap();
        is_key_of(&sec_1(&folder.join("lab")), &certificate).unwrap();
        let message = is_key_of(&sec_1(&other.join("lab")), &certificate).unwrap_err().to_string();
        assert!(message.contains("the key of another certificate"), "{message}");
        let locked =
            "-----BEGIN ENCRYPTED PRIVATE KEY-----\nBggqhkjOPQMBBw==\n-----END ENCRYPTED PRIVATE KEY-----\n";
        assert!(refused(KEY, locked.as_bytes()).contains("without a password"));
        assert!(refused(AUTHORITY, &of_other(AUTHORITY)).contains("has not signed certificate.pem"));
        check(&folder.join("lab"), "lab").unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        std::fs::remove_dir_all(&other).unwrap();
    }

    #[test]
    fn an_expired_certificate_is_named() {
        let folder = folder("expired");
        pair(&folder, "lab", "10.9.0.2".parse().unwrap(), -1, false).unwrap();
        let message = check(&folder.join("lab"), "lab").unwrap_err().to_string();
        assert!(message.contains("lab/certificate.pem: it is valid from"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
