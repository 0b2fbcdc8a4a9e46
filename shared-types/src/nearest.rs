//! The name that was meant, where one is not known.

/// Shortest beginning of a name that is taken for it.
const MIN_PREFIX: usize = 3;

/// ` Did you mean X?` with the nearest of `names`; empty where none is near.
///
/// Near is a name with one wrong, missing, added or swapped letter per three that were given, and one that begins as given.
pub fn did_you_mean<'a>(given: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let given = given.to_lowercase();
    let allowed = given.chars().count().div_ceil(3);
    let distance = |name: &str| match given.len() >= MIN_PREFIX && name.starts_with(&given) {
        true => 0,
        false => distance(&given, name),
    };
    let measured = names.into_iter().map(|name| (distance(name), name));
    let nearest = measured.filter(|(distance, _)| *distance <= allowed).min_by_key(|(distance, _)| *distance);
    nearest.map_or_else(String::new, |(_, name)| format!(" Did you mean `{name}`?"))
}

/// The number of letters that are wrong, missing, added or swapped with their neighbour.
fn distance(one: &str, other: &str) -> usize {
    let other: Vec<char> = other.chars().collect();
    // Distances of the beginnings of `one`, up to the last two letters, to all beginnings of `other`.
    let mut before: Vec<usize> = Vec::new();
    let mut last: Vec<usize> = (0..=other.len()).collect();
    let mut previous = None;
    for (index, letter) in one.chars().enumerate() {
        let mut row = vec![index + 1];
        for (place, meant) in other.iter().enumerate() {
            let replaced = last[place] + usize::from(letter != *meant);
            let mut least = replaced.min(last[place + 1] + 1).min(row[place] + 1);
            if place > 0 && previous == Some(*meant) && letter == other[place - 1] {
                least = least.min(before[place - 1] + 1);
            }
            row.push(least);
        }
        (before, last, previous) = (last, row, Some(letter));
    }
    last[other.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_wrong_missing_added_or_swapped_letter_counts_once() {
        for (one, other, expected) in [
            ("", "abc", 3),
            ("abc", "", 3),
            ("abc", "abc", 0),
            ("abd", "abc", 1),
            ("ac", "abc", 1),
            ("abbc", "abc", 1),
            ("acb", "abc", 1),
            ("bca", "abc", 2),
        ] {
            assert_eq!(distance(one, other), expected, "{one} {other}");
        }
    }

    #[test]
    fn the_nearest_name_is_meant_and_none_where_all_are_far() {
        let names = ["corridor", "slalom", "free"];
        assert_eq!(did_you_mean("coridor", names), " Did you mean `corridor`?");
        assert_eq!(did_you_mean("Slalmo", names), " Did you mean `slalom`?");
        assert_eq!(did_you_mean("corr", names), " Did you mean `corridor`?");
        assert_eq!(did_you_mean("nowhere.toml", names), "");
        assert_eq!(did_you_mean("", names), "");
    }
}
