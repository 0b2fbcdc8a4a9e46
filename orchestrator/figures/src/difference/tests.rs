use super::*;

/// Numbers that look random and are the same every time: xorshift with a multiplier.
struct Generator(u64);

impl Generator {
    fn new(seed: u64) -> Self {
        let mut generator = Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        for _ in 0..10 {
            generator.uniform();
        }
        generator
    }

    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Sum of four uniform numbers: nearly normal, mean 0, standard deviation 1.
    fn normal(&mut self) -> f64 {
        ((0..4).map(|_| self.uniform()).sum::<f64>() - 2.0) * 3.0_f64.sqrt()
    }
}

/// What a machine does to a run, in microseconds.
#[derive(Clone, Copy)]
struct Noise {
    /// Standard deviation from scan to scan.
    scan: f64,
    /// Standard deviation of what changes slowly, and how much of it stays from scan to scan.
    slow: f64,
    stays: f64,
    /// Standard deviation from run to run.
    run: f64,
}

const QUIET: Noise = Noise { scan: 40.0, slow: 0.0, stays: 0.0, run: 0.0 };
/// A second of memory at 100 Hz.
const SLOW: Noise = Noise { scan: 40.0, slow: 15.0, stays: 0.99, run: 0.0 };
/// Twenty seconds of memory, and runs that differ.
const SLOWER: Noise = Noise { scan: 40.0, slow: 15.0, stays: 0.9995, run: 5.0 };

/// A run of 24 stretches whose latencies follow a drive, with one scan in a hundred disturbed, `more` us slower.
fn run(seed: u64, scans: usize, noise: Noise, more: f64) -> Vec<Histogram<u64>> {
    let mut random = Generator::new(seed);
    let offset = noise.run * random.normal();
    let fresh = (1.0 - noise.stays * noise.stays).sqrt();
    let mut slow = random.normal();
    (0..24)
        .map(|stretch| {
            let mut histogram = Histogram::new_with_bounds(1, 1_000_000_000, 3).unwrap();
            for scan in 0..scans {
                slow = noise.stays * slow + fresh * random.normal();
                let drive = 120.0 * (0.7 * f64::from(stretch) + scan as f64 / scans as f64).sin();
                let disturbed = if random.uniform() < 0.01 { 3000.0 * random.uniform() } else { 0.0 };
                let time_us = 450.0
                    + more
                    + offset
                    + drive
                    + noise.slow * slow
                    + noise.scan * random.normal()
                    + disturbed;
                histogram.record((time_us.max(50.0) * 1e3) as u64).unwrap();
            }
            histogram
        })
        .collect()
}

/// In how many of 200 pairs of runs a difference is seen.
fn seen(noise: Noise, quantile: f64, more: f64) -> usize {
    (0..200)
        .filter(|trial| {
            let (a, b) = (run(2 * trial, 250, noise, 0.0), run(2 * trial + 1, 250, noise, more));
            stretches(&a, &b, quantile).unwrap().is_seen()
        })
        .count()
}

#[test]
fn two_files_of_the_same_build_are_not_told_apart() {
    for (noise, quantile) in [(QUIET, 0.5), (SLOW, 0.5), (SLOWER, 0.5), (SLOW, 0.99)] {
        let false_alarms = seen(noise, quantile, 0.0);
        assert!(false_alarms <= 10, "{false_alarms} of 200 with memory {} at {quantile}", noise.stays);
    }
}

#[test]
fn fifty_microseconds_between_two_files_are_found() {
    for (noise, least) in [(QUIET, 199), (SLOW, 150)] {
        let found = seen(noise, 0.5, 50.0);
        assert!(found >= least, "{found} of 200 with memory {}", noise.stays);
    }
    let (a, b) = (run(1, 250, QUIET, 0.0), run(2, 250, QUIET, 50.0));
    let difference = stretches(&a, &b, 0.5).unwrap();
    assert!((difference.value - 50_000.0).abs() < 5_000.0, "{difference:?}");
    assert!(difference.interval[0] < 50_000.0 && 50_000.0 < difference.interval[1], "{difference:?}");
}

#[test]
fn what_is_called_visible_is_seen_nine_times_in_ten() {
    let (a, b) = (run(1, 250, QUIET, 0.0), run(2, 250, QUIET, 0.0));
    let smallest_us = stretches(&a, &b, 0.5).unwrap().smallest_visible * 1e-3;
    let seen = seen(QUIET, 0.5, smallest_us);
    assert!(seen >= 160, "{seen} of 200 differences of {smallest_us} us");
}

#[test]
fn one_run_tells_about_how_small_a_difference_to_another_would_show() {
    let steady = |seed| {
        let mut random = Generator::new(seed);
        (0..24)
            .map(|_| {
                let mut histogram = Histogram::new_with_bounds(1, 1_000_000_000, 3).unwrap();
                (0..250).for_each(|_| {
                    histogram.record((200_000.0 + 20_000.0 * random.normal()) as u64).unwrap();
                });
                histogram
            })
            .collect::<Vec<_>>()
    };
    let (a, b) = (run(1, 250, QUIET, 0.0), run(2, 250, QUIET, 0.0));
    let pair = stretches(&a, &b, 0.5).unwrap().smallest_visible;
    let alone = smallest_visible(&a, &steady(3), 0.5).unwrap();
    assert!(alone > 0.3 * pair && alone < 3.0 * pair, "{alone} from one run, {pair} from two");
}

#[test]
fn too_few_scans_have_no_interval() {
    let short = run(1, 250, QUIET, 0.0);
    assert_eq!(stretches(&short[..5], &short[..5], 0.5), None);
    let few = run(1, 10, QUIET, 0.0);
    assert!(stretches(&few, &few, 0.5).is_some());
    assert_eq!(stretches(&few, &few, 0.99), None);
    assert_eq!(rounds(&[1.0; 7]), None);
    assert_eq!(rounds(&[f64::NAN; 12]), None);
}

/// Differences of rounds whose machine drifts and is disturbed now and then.
fn differences(seed: u64, count: usize, more: f64) -> Vec<f64> {
    let mut random = Generator::new(seed);
    let mut drift = 0.0;
    (0..count)
        .map(|round| {
            let mut once = || {
                drift += 8.0 + 10.0 * random.normal();
                let disturbed = if random.uniform() < 0.05 { 2000.0 * random.uniform() } else { 0.0 };
                drift + disturbed + 12.0 * random.normal()
            };
            // A comes first in even rounds, B in odd ones.
            let (first, second) = (once(), once());
            more + if round % 2 == 0 { second - first } else { first - second }
        })
        .collect()
}

#[test]
fn turns_of_the_same_build_are_not_told_apart() {
    for count in [8, 10, 25] {
        let seen = |seed| rounds(&differences(seed, count, 0.0)).unwrap().is_seen();
        let false_alarms = (0..1000).filter(|seed| seen(*seed)).count();
        assert!(false_alarms <= 20, "{false_alarms} of 1000 with {count} rounds");
    }
}

#[test]
fn fifty_microseconds_are_found_in_turns() {
    let seen = |seed: &u64| {
        let difference = rounds(&differences(*seed, 15, 50.0)).unwrap();
        difference.is_seen() && difference.value > 0.0
    };
    let found = (0..200).filter(seen).count();
    assert!(found >= 180, "{found} of 200");
}

#[test]
fn the_interval_leaves_out_as_many_rounds_as_the_binomial_allows() {
    // Two-sided 1 % of the sign test.
    assert_eq!([8, 11, 12, 15, 20, 30, 1000].map(outside), [0, 0, 1, 2, 3, 7, 458]);
    let difference = rounds(&[3.0, 1.0, 2.0, 5.0, 4.0, 6.0, 8.0, 7.0]).unwrap();
    assert_eq!((difference.value, difference.interval), (4.5, [1.0, 8.0]));
}

#[test]
fn with_the_rounds_that_settle_it_a_difference_is_seen_nine_times_in_ten() {
    let seen = |seed: u64, count: usize, more: f64| {
        let mut random = Generator::new(seed);
        rounds(&(0..count).map(|_| more + 40.0 * random.normal()).collect::<Vec<_>>()).unwrap()
    };
    let smallest = (0..200).map(|seed| seen(seed, 12, 0.0).smallest_visible).sum::<f64>() / 200.0;
    let estimate = DifferenceEstimate { value: 15.0, interval: [-30.0, 60.0], smallest_visible: smallest };
    let needed = estimate.rounds_to_settle(12).unwrap();
    assert!((60..300).contains(&needed), "{needed}");
    let found = (0..200).filter(|seed| seen(1000 + seed, needed, 15.0).is_seen()).count();
    assert!((160..=199).contains(&found), "{found} of 200 with {needed} rounds");
}

#[test]
fn an_estimate_of_zero_is_settled_by_no_number_of_rounds() {
    let of = |value: f64| DifferenceEstimate { value, interval: [-2.0, 2.0], smallest_visible: 3.0 };
    assert_eq!([of(0.0), of(0.1), of(30.0)].map(|one| one.rounds_to_settle(12)), [None, None, Some(13)]);
    assert_eq!(of(1.5).rounds_to_settle(12), Some(48));
}
