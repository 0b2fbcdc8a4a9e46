//! What is expected otherwise of the cells of another vehicle.

use std::collections::BTreeMap;

use serde::Deserialize;
use shared_types::did_you_mean;

use crate::fault::{DrivePhase, InPhase, InjectedFault};

/// What differs in some phases of some faults: a table `[fault.phase]` for each cell, with the keys of `[in.phase]` of a fault.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(transparent)]
pub struct Exceptions(BTreeMap<String, BTreeMap<DrivePhase, InPhase>>);

impl Exceptions {
    /// Those of a file of TOML.
    ///
    /// # Errors
    /// Line, key and what is allowed; a cell without its reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        let exceptions: Self = toml::from_str(text).map_err(|error| error.to_string())?;
        let mut all = exceptions.0.iter().flat_map(|(name, phases)| phases.iter().map(move |of| (name, of)));
        match all.find(|(_, (_, differs))| differs.because.trim().is_empty()) {
            Some((name, (phase, _))) => Err(format!("{name}.{phase}.because is missing: why it differs")),
            None => Ok(exceptions),
        }
    }

    /// The faults with what differs.
    ///
    /// # Errors
    /// A name that no fault has, and expectations that are not allowed.
    pub fn applied(&self, mut faults: Vec<InjectedFault>) -> Result<Vec<InjectedFault>, String> {
        for (name, phases) in &self.0 {
            let Some(fault) = faults.iter_mut().find(|fault| fault.name == *name) else {
                let meant = did_you_mean(name, faults.iter().map(|fault| fault.name.as_str()));
                return Err(format!("no fault is named {name}.{meant}"));
            };
            for (phase, differs) in phases {
                fault.in_phase.entry(*phase).or_default().adopt(differs);
            }
            fault.validate().map_err(|reason| format!("{name}: {reason}"))?;
        }
        Ok(faults)
    }
}

impl InPhase {
    /// Takes over what is given in `other`.
    fn adopt(&mut self, other: &Self) {
        let Self { outcomes, detected_by, within_ms, detectable_ms, skip, because } = other.clone();
        self.outcomes = outcomes.or(self.outcomes.take());
        self.detected_by = detected_by.or(self.detected_by.take());
        self.within_ms = within_ms.or(self.within_ms);
        self.detectable_ms = detectable_ms.or(self.detectable_ms);
        (self.skip, self.because) = (skip, because);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_differs_in_what_is_given_and_keeps_the_rest() {
        let text = "[steering-slow.start]\ndetectable_ms = 9000\nbecause = \"it is large\"\n\
                    [gyro-jump.swap]\nskip = true\nbecause = \"it is not possible\"";
        let before = crate::all().unwrap();
        let faults = Exceptions::parse(text).unwrap().applied(before.clone()).unwrap();
        let of =
            |faults: &[InjectedFault], name| faults.iter().find(|fault| fault.name == name).cloned().unwrap();
        let (was, is) = (of(&before, "steering-slow"), of(&faults, "steering-slow"));
        let (was, is) = (was.expected(DrivePhase::Start), is.expected(DrivePhase::Start));
        assert_eq!((is.detectable_ms, is.within_ms, &is.outcomes), (9000.0, was.within_ms, &was.outcomes));
        assert!(of(&faults, "gyro-jump").phases().all(|phase| phase != DrivePhase::Swap));
        assert_eq!(of(&before, "gyro-drifts"), of(&faults, "gyro-drifts"));
    }

    #[test]
    fn an_unknown_name_a_missing_reason_and_an_unknown_key_are_refused() {
        let refused = |text: &str| match Exceptions::parse(text) {
            Ok(exceptions) => exceptions.applied(crate::all().unwrap()).unwrap_err(),
            Err(reason) => reason,
        };
        let unknown = refused("[steering-slwo.start]\nwithin_ms = 1\nbecause = \"x\"");
        assert!(unknown.contains("no fault is named steering-slwo") && unknown.contains("steering-slow"));
        assert!(refused("[steering-slow.start]\nwithin_ms = 1").contains("steering-slow.start.because"));
        assert!(refused("[steering-slow.middle]\nbecause = \"x\"").contains("middle"));
        assert!(refused("[steering-slow.start]\nlater = 1\nbecause = \"x\"").contains("later"));
        assert!(refused("[steering-slow.start]\nwithin_ms = -1\nbecause = \"x\"").contains("steering-slow"));
    }
}
