//! The outputs of both processes of an exchange, whoever counts.

use runtime::{Bus, Observer, RuntimeError};
use shared_types::{Actuation, Command, Obstacles, Pose, Role, Sample};

use super::{Gist, Output, Party};

/// Looks at the topic of one role.
pub(crate) enum Watch {
    Poses(Observer<Pose>),
    Obstacles(Observer<Obstacles>),
    Commands(Observer<Command>),
    Actuations(Observer<Actuation>),
}

impl Watch {
    /// Starts looking at what `role` publishes; nothing for the robot.
    pub(crate) fn new(bus: &Bus, role: Role) -> Result<Option<Self>, RuntimeError> {
        Ok(match role {
            Role::Robot => None,
            Role::Estimator => Some(Self::Poses(Observer::new(bus)?)),
            Role::Obstacles => Some(Self::Obstacles(Observer::new(bus)?)),
            Role::Controller => Some(Self::Commands(Observer::new(bus)?)),
            Role::Actuator => Some(Self::Actuations(Observer::new(bus)?)),
        })
    }

    /// Hands what has come from the incarnations `old` and `new` to `each`.
    pub(crate) fn poll(
        &self,
        old: u32,
        new: u32,
        mut each: impl FnMut(Party, Output),
    ) -> Result<(), RuntimeError> {
        let role = match self {
            Self::Poses(_) => Role::Estimator,
            Self::Obstacles(_) => Role::Obstacles,
            Self::Commands(_) => Role::Controller,
            Self::Actuations(_) => Role::Actuator,
        };
        let mut each = |incarnation: u32, output: Output| {
            if incarnation == old {
                each(Party::Old, output);
            } else if incarnation == new {
                each(Party::New, output);
            }
        };
        match self {
            Self::Poses(observer) => take(observer, role, |_| true, &mut each),
            Self::Obstacles(observer) => take(observer, role, |_| true, &mut each),
            Self::Commands(observer) => take(observer, role, |_| true, &mut each),
            // What the actuator does by itself answers no scan.
            Self::Actuations(observer) => take(observer, role, |sample| sample.answers == 1, &mut each),
        }
    }
}

fn take<S: Sample>(
    observer: &Observer<S>,
    role: Role,
    counts: impl Fn(&S) -> bool,
    each: &mut impl FnMut(u32, Output),
) -> Result<(), RuntimeError>
where
    for<'a> Gist: From<&'a S>,
{
    while let Some((sample, checked)) = observer.next()? {
        if !counts(&sample) {
            continue;
        }
        let header = sample.header();
        let output = Output {
            scan: header.scan_id,
            scan_published_ns: header.scan_published_ns(),
            published_ns: header.stage(role).published_ns,
            content: checked.map(|()| Gist::from(&sample)).map_err(|fault| fault.to_string()),
        };
        each(header.incarnation, output);
    }
    Ok(())
}
