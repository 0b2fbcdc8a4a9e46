//! Ranges of any model as the beams of a scan.
//!
//! Each beam takes the smallest range among the steps of the scanner within half of the angle between two beams of it, so that nothing near is
//! lost. If none of them has a return, it takes the error code of the step nearest to it. A beam that the scanner never
//! measures has [`NOT_MEASURED`]: an error code like the others, which shows neither an obstacle nor free space.

use shared_types::{MIN_RANGE_MM, ScanGeometry};

use crate::command::{Coding, Measurement};
use crate::model::SensorParameters;

/// Error code of beams that the scanner never measures: "not measurable" of the URG-04LX.
pub const NOT_MEASURED: u32 = 19;
/// Error code of a range beyond the reach of the scanner or of the coding.
const BEYOND: u32 = 0;
/// Error code of a range below the shortest one of a model that is no error code of it: "other".
const TOO_NEAR: u32 = 6;
/// Two and three characters code no larger range: it stands for all that are [mm].
const MAX_OF_TWO: u32 = 4095;
const MAX_OF_THREE: u32 = 262_143;

/// Which ranges of the scanner belong to a beam.
#[derive(Debug, Clone, Copy, Default)]
struct Source {
    first: u16,
    /// After the last one; with `first` it is empty for a beam that is never measured.
    end: u16,
    /// The one nearest to the beam.
    nearest: u16,
}

/// How the ranges of one measurement become beams.
#[derive(Debug, Clone)]
pub struct Resampling {
    sources: Vec<Source>,
    min_mm: u32,
    max_mm: u32,
}

impl Resampling {
    /// What these beams get of a measurement of a model.
    pub fn new(parameters: &SensorParameters, measurement: &Measurement, beams: &ScanGeometry) -> Self {
        let max_mm = match measurement.coding {
            Coding::Two => parameters.max_mm.min(MAX_OF_TWO - 1),
            Coding::Three => parameters.max_mm.min(MAX_OF_THREE - 1),
        };
        let of_beam = |beam| source_of(beams.yaw_rad(beam), beams.increment_rad, parameters, measurement);
        let sources = (0..beams.count).map(of_beam).collect();
        Self { sources, min_mm: parameters.min_mm.max(MIN_RANGE_MM), max_mm }
    }

    /// Number of beams that the measurement reaches.
    pub fn measured(&self) -> usize {
        self.sources.iter().filter(|source| source.first < source.end).count()
    }

    /// Fills the beams with the ranges of a scan [mm, or an error code below 20].
    pub fn apply(&self, ranges: &[u32], beams: &mut [u32]) {
        for (beam, source) in beams.iter_mut().zip(&self.sources) {
            let group = ranges.get(usize::from(source.first)..usize::from(source.end)).unwrap_or_default();
            let valid = group.iter().filter(|range| (self.min_mm..=self.max_mm).contains(*range)).min();
            *beam = match (valid, ranges.get(usize::from(source.nearest))) {
                (Some(range), _) => *range,
                (None, Some(code)) if !group.is_empty() => self.code_of(*code),
                _ => NOT_MEASURED,
            };
        }
    }

    /// The error code of a range that is none.
    fn code_of(&self, range: u32) -> u32 {
        match range {
            range if range < MIN_RANGE_MM => range,
            range if range > self.max_mm => BEYOND,
            _ => TOO_NEAR,
        }
    }
}

/// The ranges for a beam in a direction.
fn source_of(
    yaw_rad: f64,
    pitch_rad: f64,
    parameters: &SensorParameters,
    measurement: &Measurement,
) -> Source {
    let cluster = f64::from(measurement.cluster.max(1));
    let count = measurement.ranges() as f64;
    let steps_per_rad = f64::from(parameters.steps) / std::f64::consts::TAU;
    // Position of the beam among the ranges; the middle of range k is at k.
    let step = f64::from(parameters.front) + yaw_rad * steps_per_rad - f64::from(measurement.first);
    let position = (step - (cluster - 1.0) / 2.0) / cluster;
    let half = pitch_rad * steps_per_rad / cluster / 2.0;
    let nearest = position.round();
    if nearest < 0.0 || nearest >= count {
        return Source::default();
    }
    // Not both neighbours of a beam exactly between two of its own steps.
    const ROUNDING: f64 = 1e-6;
    let first = (position - half + ROUNDING).ceil().clamp(0.0, nearest);
    let last = (position + half - ROUNDING).floor().clamp(nearest, count - 1.0);
    Source { first: first as u16, end: last as u16 + 1, nearest: nearest as u16 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{BEAMS, FRONT_BEAM, PITCH_RAD};

    fn model(steps: u32, first: u32, last: u32, front: u32) -> SensorParameters {
        SensorParameters {
            model: String::new(),
            min_mm: 20,
            max_mm: 30_000,
            steps,
            first,
            last,
            front,
            rpm: 600,
        }
    }

    fn full(parameters: &SensorParameters) -> Measurement {
        let [first, last] = [parameters.first, parameters.last].map(|step| step as u16);
        Measurement { first, last, ..Measurement::default() }
    }

    #[test]
    fn the_usual_model_is_copied_beam_by_beam() {
        let parameters = model(1024, 44, 725, 384);
        let resampling = Resampling::new(&parameters, &full(&parameters), &ScanGeometry::URG_04LX);
        let ranges: Vec<u32> = (0..682).map(|index| 1000 + index).collect();
        let mut beams = [0; BEAMS];
        resampling.apply(&ranges, &mut beams);
        assert!(beams.iter().zip(1000..).all(|(beam, expected)| *beam == expected));
        assert_eq!(resampling.measured(), BEAMS);
    }

    #[test]
    fn beams_outside_of_a_window_are_not_measured() {
        let parameters = model(1024, 44, 725, 384);
        let window = Measurement { first: 214, last: 555, ..Measurement::default() };
        let resampling = Resampling::new(&parameters, &window, &ScanGeometry::URG_04LX);
        let mut beams = [0; BEAMS];
        resampling.apply(&[2000; 342], &mut beams);
        assert_eq!(
            (beams[169], beams[170], beams[511], beams[512]),
            (NOT_MEASURED, 2000, 2000, NOT_MEASURED)
        );
    }

    #[test]
    fn a_finer_model_gives_the_nearest_return_of_each_beam() {
        // UTM-30LX: 0.25 deg, 1081 steps, +-135 deg.
        let parameters = model(1440, 0, 1080, 540);
        let resampling = Resampling::new(&parameters, &full(&parameters), &ScanGeometry::URG_04LX);
        assert_eq!(resampling.measured(), BEAMS);
        let mut beams = [0; BEAMS];
        for step in 380..=700 {
            let mut ranges = vec![5000; 1081];
            ranges[step] = 700;
            resampling.apply(&ranges, &mut beams);
            let hit: Vec<usize> = (0..BEAMS).filter(|beam| beams[*beam] == 700).collect();
            assert!(!hit.is_empty(), "step {step} is lost");
            let yaw = parameters.yaw_rad(step as f64);
            assert!(
                hit.iter().all(|beam| (ScanGeometry::URG_04LX.yaw_rad(*beam) - yaw).abs() < PITCH_RAD),
                "{step}: {hit:?}"
            );
        }
    }

    #[test]
    fn a_finer_model_that_is_described_keeps_all_its_steps_and_its_reach() {
        let parameters = SensorParameters { max_mm: 100_000, ..model(1440, 0, 1080, 540) };
        let increment_rad = std::f64::consts::TAU / 1440.0;
        let geometry = ScanGeometry { count: 1081, first_rad: -540.0 * increment_rad, increment_rad };
        assert_eq!(parameters.steps_of_beams(&geometry), (0, 1080));
        let resampling = Resampling::new(&parameters, &full(&parameters), &geometry);
        let ranges: Vec<u32> = (0..1081).map(|index| 1000 + 80 * index).collect();
        let mut beams = vec![0; 1081];
        resampling.apply(&ranges, &mut beams);
        assert_eq!(beams, ranges);
    }

    #[test]
    fn a_coarser_model_and_merged_steps_keep_their_directions() {
        let parameters = model(1024, 44, 725, 384);
        let merged = Measurement { cluster: 4, ..full(&parameters) };
        let resampling = Resampling::new(&parameters, &merged, &ScanGeometry::URG_04LX);
        let mut ranges = vec![5000; merged.ranges()];
        ranges[(384 - 44) / 4] = 700;
        let mut beams = [0; BEAMS];
        resampling.apply(&ranges, &mut beams);
        let hit: Vec<usize> = (0..BEAMS).filter(|beam| beams[*beam] == 700).collect();
        assert_eq!(hit, (FRONT_BEAM..FRONT_BEAM + 4).collect::<Vec<_>>());
    }

    #[test]
    fn what_is_no_range_becomes_an_error_code() {
        let parameters = SensorParameters { min_mm: 60, max_mm: 4095, ..model(1024, 44, 725, 384) };
        let resampling = Resampling::new(&parameters, &full(&parameters), &ScanGeometry::URG_04LX);
        let mut ranges = vec![1; 682];
        (ranges[0], ranges[1], ranges[2], ranges[3]) = (7, 30, 4096, 4095);
        let mut beams = [0; BEAMS];
        resampling.apply(&ranges, &mut beams);
        assert_eq!(beams[..5], [7, TOO_NEAR, BEYOND, 4095, 1]);
        let two = Measurement { coding: Coding::Two, ..full(&parameters) };
        Resampling::new(&parameters, &two, &ScanGeometry::URG_04LX).apply(&ranges, &mut beams);
        assert_eq!(beams[3], BEYOND, "4095 stands for everything beyond");
    }
}
