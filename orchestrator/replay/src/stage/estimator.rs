//! Recomputes poses.

use estimator::{EstimatorConfig, EstimatorState};
use shared_types::{Actuation, JournalEntry, JournalKind, Odometry, Pose, Role, Topic};

use super::journal::{Missing, Stage, Taking};
use crate::ReplayDrive;

/// The process of an estimator.
pub(super) struct Estimator {
    estimator: estimator::Estimator,
    taken: Option<Result<Input, Missing>>,
    pose: Option<Pose>,
}

/// What an estimator takes.
enum Input {
    Actuation(Actuation),
    Odometry(Odometry),
}

impl Stage for Estimator {
    type Output = Pose;
    type State = EstimatorState;
    const ROLE: Role = Role::Estimator;

    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self> {
        let config: EstimatorConfig = drive.table_of(incarnation, Role::Estimator, "estimator")?;
        Ok(Self { estimator: estimator::Estimator::new(&config)?, taken: None, pose: None })
    }

    fn resume(&mut self, state: &EstimatorState) -> bool {
        self.estimator.resume(state).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>) {
        self.taken = Some(if entry.topic == Topic::Actuation as u16 {
            taking.sample(&taking.drive.actuations, entry).map(Input::Actuation)
        } else {
            taking.sample(&taking.drive.odometries, entry).map(Input::Odometry)
        });
    }

    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing> {
        if kind == JournalKind::Used {
            match self.taken.take().ok_or(Missing::Input)?? {
                Input::Actuation(actuation) => self.estimator.note(&actuation, value),
                Input::Odometry(odometry) => self.pose = self.estimator.step(&odometry, None, value),
            }
        }
        Ok(())
    }

    fn output(&mut self, _: u64) -> Result<Pose, Missing> {
        self.pose.take().ok_or(Missing::Input)
    }
}
