//! A scanner whose ranges are all too long, or too short, by the same: no pose explains that where surfaces face each other.
//!
//! Pose and offset are fitted to the scan together (point to line, by least squares), the pose nearly free. An offset that
//! several scans in a row agree on is taken off the ranges from then on.

use nalgebra::{Matrix3, Vector2, Vector3};
use shared_types::plain_state;

use super::align::{Prior, nearest};
use super::pieces::{Piece, Pieces};
use super::surface::SurfaceLine;
use crate::dead_reckoning::DeadReckoning;

/// So many scans in a row have to agree, to this [m].
const AGREE: (u64, f64) = (3, 0.02);
/// A smaller one is left to the match, a larger one is none of a scanner [m]; so many standard deviations of it.
const OFFSETS_M: std::ops::RangeInclusive<f64> = 0.03..=0.5;
const SIGMAS: f64 = 4.0;
/// How well the pose is known apart from it [m, rad].
const FREE: (f64, f64) = (0.3, 0.03);
/// A piece is looked for so far from its line, in standard deviations [m].
const WIDE_M: f64 = 0.1;
/// Standard deviation of the place of a piece, its noise aside [m].
const BIAS_M: f64 = 0.01;
/// Share of the squares that the offset explains.
const EXPLAINED: f64 = 0.8;
/// Share of the returns on surfaces that are known which are not where they should be.
const BESIDE: f64 = 0.7;

plain_state! {
    /// What the ranges have too much.
    pub struct RangeOffset {
        /// What is taken off each [m]
        pub offset_m: f64,
        /// What the last scan showed beyond that [m]
        pub more_m: f64,
        /// Scans in a row that agree on it
        pub agree: u64,
        /// How often another one was found
        pub found: u64,
    }
}

impl RangeOffset {
    /// Whether scans contradict the offset in use, so that they show no pose.
    pub fn is_in_doubt(&self) -> bool {
        self.agree > 0
    }

    /// What is taken off each range, and what the last scan shows beyond that [m].
    pub fn seems_m(&self) -> f64 {
        self.offset_m + if self.is_in_doubt() { self.more_m } else { 0.0 }
    }

    /// Takes a scan into account; true when another offset is used from now on.
    pub(super) fn follow(
        &mut self,
        pieces: &Pieces,
        lines: &[SurfaceLine],
        reckoning: &DeadReckoning,
    ) -> bool {
        let Some(more_m) = shown(pieces, lines, &Prior::of(reckoning)) else {
            self.agree = 0;
            return false;
        };
        let agrees = self.agree > 0 && (more_m - self.more_m).abs() <= AGREE.1;
        (self.agree, self.more_m) = (if agrees { self.agree + 1 } else { 1 }, more_m);
        if self.agree < AGREE.0 {
            return false;
        }
        *self = Self { offset_m: self.offset_m + more_m, found: self.found + 1, ..Self::default() };
        true
    }
}

/// What all ranges have too much, where the scan shows it [m]: not where it shows what is known in its place.
fn shown(pieces: &Pieces, lines: &[SurfaceLine], prior: &Prior) -> Option<f64> {
    let is_known = |piece: &&Piece| {
        nearest(piece, lines, &prior.pose, pieces.noise_m, prior, |line| line.counts).is_some()
    };
    let all: f64 = pieces.all().iter().map(|piece| piece.count).sum();
    let as_known: f64 = pieces.all().iter().filter(is_known).map(|piece| piece.count).sum();
    if as_known > (1.0 - BESIDE) * all { None } else { fit(pieces, lines, prior, as_known) }
}

/// The same by least squares; `as_known` returns are on surfaces where these should be.
fn fit(pieces: &Pieces, lines: &[SurfaceLine], prior: &Prior, as_known: f64) -> Option<f64> {
    let square = |sigma: f64| sigma * sigma;
    let wide = Matrix3::from_diagonal(&Vector3::new(0.0, square(WIDE_M), square(WIDE_M)));
    let prior = Prior { covariance: prior.covariance + wide, ..*prior };
    let mut returns = 0.0;
    let robot = Vector2::new(prior.pose[1], prior.pose[2]);
    // Sums for the least squares in pose and offset.
    let (mut by_pose, mut pose_off, mut both) = (Matrix3::zeros(), Vector3::zeros(), Vector3::zeros());
    let (mut by_offset, mut offset_off, mut squares) = (0.0, 0.0, 0.0);
    for piece in pieces.all() {
        let pair = nearest(piece, lines, &prior.pose, pieces.noise_m, &prior, |line| line.counts);
        let Some(pair) = pair else { continue };
        returns += piece.count;
        let weight = 1.0 / (square(pieces.noise_m) / piece.count + square(BIAS_M) + pair.variance());
        let (slope, off_m) = (pair.slope, pair.off_m);
        let longer = pair.line.normal.dot(&(pair.placed.mean - robot).normalize());
        by_pose += slope * slope.transpose() * weight;
        pose_off += slope * (off_m * weight);
        both += slope * (longer * weight);
        by_offset += longer * longer * weight;
        offset_off += longer * off_m * weight;
        squares += off_m * off_m * weight;
    }
    if as_known > (1.0 - BESIDE) * returns {
        return None;
    }
    let free = Matrix3::from_diagonal(&Vector3::new(square(FREE.1), square(FREE.0), square(FREE.0)));
    let left = free * (Matrix3::identity() + by_pose * free).try_inverse()?;
    let information = by_offset - both.dot(&(left * both));
    if information <= 0.0 {
        return None;
    }
    let offset_m = (offset_off - both.dot(&(left * pose_off))) / information;
    let squares = squares - pose_off.dot(&(left * pose_off));
    let explained = offset_m * offset_m * information;
    let is_there =
        OFFSETS_M.contains(&offset_m.abs()) && explained > SIGMAS * SIGMAS && explained > EXPLAINED * squares;
    is_there.then_some(offset_m)
}
