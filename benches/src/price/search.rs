//! Bisection over whole numbers.

/// The smallest number from `low` to `high` that passes, if all numbers pass from some number on.
///
/// `None` when `high` does not pass. Needs about log2(`high` - `low`) trials.
///
/// # Errors
/// The first error of a trial.
pub(super) fn smallest<E>(
    mut low: u32,
    mut high: u32,
    mut passes: impl FnMut(u32) -> Result<bool, E>,
) -> Result<Option<u32>, E> {
    if !passes(high)? {
        return Ok(None);
    }
    while low < high {
        let middle = low + (high - low) / 2;
        if passes(middle)? {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    Ok(Some(high))
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    #[test]
    fn every_threshold_is_found_with_few_trials() {
        for threshold in 0..=160 {
            let mut trials = 0;
            let found = smallest(0, 160, |number| {
                trials += 1;
                Ok::<_, Infallible>(number >= threshold)
            });
            assert_eq!(found, Ok(Some(threshold)));
            assert!(trials <= 9, "{trials} trials for {threshold}");
        }
    }

    #[test]
    fn nothing_is_found_where_the_largest_fails() {
        let mut tried = Vec::new();
        let found = smallest(0, 160, |number| {
            tried.push(number);
            Ok::<_, Infallible>(false)
        });
        assert_eq!((found, tried), (Ok(None), vec![160]));
    }

    #[test]
    fn the_first_error_ends_the_search() {
        assert_eq!(smallest(0, 9, |number| if number == 9 { Ok(true) } else { Err(number) }), Err(4));
    }
}
