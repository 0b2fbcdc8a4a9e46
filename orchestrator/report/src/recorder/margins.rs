//! The clearance and the speed limit that the commands of a drive state.

use shared_types::{Command, CommandKind, Margin};

use crate::report::MarginReport;

/// Sums over all commands that drive.
#[derive(Debug, Clone, Default)]
pub(super) struct Margins {
    count: u64,
    sum: MarginReport,
    speed_limit_mps: Option<f64>,
}

impl Margins {
    /// Adds the parts and the speed limit of a command that drives; one without finite parts does not count.
    pub(super) fn command(&mut self, command: &Command) {
        if command.kind != CommandKind::Drive.wire() {
            return;
        }
        let Margin { base_m, pose_m, latency_m, model_m, perception_m } = command.margin;
        if command.margin.sum().is_finite() {
            self.count += 1;
            self.sum.base += base_m;
            self.sum.pose += pose_m;
            self.sum.latency += latency_m;
            self.sum.model += model_m;
            self.sum.perception += perception_m;
        }
        // A controller that knows no limit leaves the field zero.
        let limit_mps = command.speed_limit_mps;
        if limit_mps > 0.0 && limit_mps.is_finite() {
            self.speed_limit_mps = Some(self.speed_limit_mps.map_or(limit_mps, |least| least.min(limit_mps)));
        }
    }

    /// Mean of each part [m].
    pub(super) fn means(&self) -> MarginReport {
        let count = self.count.max(1) as f64;
        let MarginReport { base, pose, latency, model, perception } = self.sum;
        MarginReport {
            base: base / count,
            pose: pose / count,
            latency: latency / count,
            model: model / count,
            perception: perception / count,
        }
    }

    /// The smallest speed limit [m/s].
    pub(super) fn speed_limit_mps(&self) -> Option<f64> {
        self.speed_limit_mps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_commands_that_drive() {
        let command = |kind: CommandKind, base_m, pose_m, speed_limit_mps| {
            let mut command = Command { kind: kind.wire(), speed_limit_mps, ..Command::default() };
            command.margin = Margin { base_m, pose_m, latency_m: 0.01, model_m: 0.02, perception_m: 0.03 };
            command
        };
        let mut margins = Margins::default();
        assert_eq!((margins.means(), margins.speed_limit_mps()), (MarginReport::default(), None));
        margins.command(&command(CommandKind::Drive, 0.05, 0.1, 0.9));
        margins.command(&command(CommandKind::Drive, 0.05, 0.3, 0.6));
        margins.command(&command(CommandKind::Drive, f64::NAN, 0.3, 0.0));
        margins.command(&command(CommandKind::Stop, 9.0, 9.0, 0.1));
        let expected = [0.05, 0.2, 0.01, 0.02, 0.03];
        let MarginReport { base, pose, latency, model, perception } = margins.means();
        for (mean, expected) in [base, pose, latency, model, perception].into_iter().zip(expected) {
            assert!((mean - expected).abs() < 1e-12, "{mean} {expected}");
        }
        assert_eq!(margins.speed_limit_mps(), Some(0.6));
    }
}
