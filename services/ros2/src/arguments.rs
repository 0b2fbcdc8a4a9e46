//! Arguments `KEY=VALUE` of the programs that a person or a system file starts.

use driver::ros2::Ros2Config;

/// Keys that every program has: where its topics are, as in the table `[ros2]`.
const COMMON: &str = "domain=NUMBER, interface=ADDRESS, namespace=/NAME";

/// Where the topics are. Any other argument goes to `own` as its key and its value, which is empty without `=`; false refuses it.
///
/// # Errors
/// An argument that `own` does not take, or whose value is not allowed, with what is: the common keys and `known`.
pub(crate) fn read<'a>(
    arguments: &[&'a str],
    namespace: &str,
    known: &str,
    mut own: impl FnMut(&str, &'a str) -> bool,
) -> Result<Ros2Config, String> {
    let mut config = Ros2Config { namespace: namespace.to_owned(), ..Ros2Config::default() };
    for argument in arguments {
        let refused = || format!("{argument} is not allowed: some of {COMMON}{known}");
        match argument.split_once('=') {
            Some(("domain", value)) => config.domain = value.parse().map_err(|_| refused())?,
            Some(("interface", value)) => config.interface = value.to_owned(),
            Some(("namespace", value)) => config.namespace = value.trim_end_matches('/').to_owned(),
            pair => {
                let (key, value) = pair.unwrap_or((argument, ""));
                if !own(key, value) {
                    return Err(refused());
                }
            }
        }
    }
    config.validate().map_err(|invalid| invalid.to_string())?;
    Ok(config)
}

/// A number that is finite.
pub(crate) fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Three finite numbers with commas between them.
pub(crate) fn three(text: &str) -> Option<[f64; 3]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(finite).collect();
    numbers?.try_into().ok()
}

/// The name of a topic.
pub(crate) fn topic(text: &str) -> Option<String> {
    driver::ros2::is_name(text).then(|| text.to_owned())
}

/// Puts a value in its place; false when there is none.
pub(crate) fn set<T>(place: &mut T, value: Option<T>) -> bool {
    value.map(|value| *place = value).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_keys_are_read_and_what_no_program_takes_is_refused_with_what_is_allowed() {
        let mut place = [0.0; 3];
        let config = read(&["domain=7", "at=1,-2,0.5"], "/scanloop", ", at=X,Y,YAW", |key, value| {
            key == "at" && set(&mut place, three(value))
        });
        let config = config.unwrap();
        assert_eq!((config.domain, config.topic("plan").as_str()), (7, "/scanloop/plan"));
        assert_eq!(place, [1.0, -2.0, 0.5]);
        assert_eq!(read(&["namespace=/"], "/scanloop", "", |_, _| false).unwrap().topic("plan"), "/plan");
        for wrong in ["domain=x", "at=1", "colour=red", "namespace"] {
            let own = |key: &str, value: &str| key == "at" && three(value).is_some();
            let refused = read(&[wrong], "", ", at=X,Y,YAW", own).unwrap_err();
            assert!(refused.starts_with(&format!("{wrong} is not allowed: some of domain=")), "{refused}");
            assert!(refused.ends_with("namespace=/NAME, at=X,Y,YAW"), "{refused}");
        }
        assert_eq!(
            read(&["domain=300"], "", "", |_, _| false).unwrap_err(),
            "domain = 300 is not allowed: 0 to 232"
        );
        assert_eq!((finite("inf"), finite("0.5"), three("1,nan,0")), (None, Some(0.5), None));
    }
}
