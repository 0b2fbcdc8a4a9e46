//! Profiles of the controller: sets of default values for the tables `[controller]` and `[obstacles]`.
//!
//! A profile is no mode: it only sets keys. So each of its values can be set alone, and overridden.

use toml::{Table, Value};

/// The values of `[controller] profile = "source"`.
const SOURCE: &str = include_str!("../profiles/source.toml");

/// The tables of the profile `source`.
pub fn source() -> Table {
    SOURCE.parse().unwrap_or_default()
}

/// Adds the values of the profile that `system` names, where the keys are not set.
pub fn add(system: &mut Table) {
    let name = system.get("controller").and_then(|table| table.get("profile")).and_then(Value::as_str);
    if name == Some("source") {
        fill(system, source());
    }
}

/// Adds the keys of `defaults` that `table` does not have.
fn fill(table: &mut Table, defaults: Table) {
    for (key, value) in defaults {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(defaults)) => fill(inner, defaults),
            (Some(_), _) => {}
            (None, value) => _ = table.insert(key, value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tuning;
    use nmpc::SideRule;
    use obstacles::CoverRule;

    fn tuning(text: &str) -> Tuning {
        let mut table: Table = text.parse().unwrap();
        add(&mut table);
        table.try_into().unwrap()
    }

    #[test]
    fn the_profile_of_the_source_has_its_methods_and_is_allowed() {
        let Tuning { controller, obstacles, .. } = tuning("[controller]\nprofile = \"source\"");
        assert_eq!((controller.horizon_s, controller.intervals), (2.72, 6));
        assert_eq!(controller.side, SideRule::Nearest);
        let solver = toml::to_string(&controller.solver).unwrap();
        for line in ["scheme = \"gauss2\"", "hessian = \"bfgs\"", "refine = false"] {
            assert!(solver.contains(line), "{solver}");
        }
        assert_eq!(obstacles.cover, CoverRule::Source);
        assert_eq!(tuning("[controller]\nprofile = \"source\"").validate(), Ok(()));
    }

    #[test]
    fn keys_that_are_set_hold_with_the_profile() {
        let text = "[controller]\nprofile = \"source\"\nside = \"right\"\nintervals = 8\n\
            [controller.solver]\nhessian = \"exact\"\n[obstacles]\ncover = \"tight\"";
        let Tuning { controller, obstacles, .. } = tuning(text);
        assert_eq!((controller.side, controller.intervals), (SideRule::Right, 8));
        assert_eq!((controller.horizon_s, obstacles.cover), (2.72, CoverRule::Tight));
        let solver = toml::to_string(&controller.solver).unwrap();
        assert!(solver.contains("hessian = \"exact\"") && solver.contains("scheme = \"gauss2\""), "{solver}");
    }

    #[test]
    fn without_a_profile_and_with_the_own_one_nothing_changes() {
        assert_eq!(tuning(""), Tuning::default());
        assert_eq!(tuning("[controller]\nprofile = \"scanloop\""), Tuning::default());
    }
}
