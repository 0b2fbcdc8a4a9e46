//! Statistics of measurements: distributions, confidence intervals by resampling, exact bounds of probabilities, differences of two runs with their
//! confidence, the profile of the measured build, and tables as text.

mod binomial;
pub mod bootstrap;
pub mod difference;
mod distribution;
mod student;
mod table;

pub use binomial::upper_bound_95;
pub use distribution::{Distribution, Figures};
pub use student::student;
pub use table::{Align, Table};

/// The Cargo profile that this executable was built with, from the path of the build: `dev`, `release`, `dist`, ...
pub const PROFILE: &str = env!("SCANLOOP_PROFILE");
/// The profile of installed executables; times should be measured with it.
pub const MEASURED_PROFILE: &str = "dist";

#[cfg(test)]
mod tests {
    #[test]
    fn tests_are_built_with_a_profile_that_has_a_name() {
        assert!(!["", "unknown", "debug"].contains(&super::PROFILE), "{}", super::PROFILE);
    }
}
