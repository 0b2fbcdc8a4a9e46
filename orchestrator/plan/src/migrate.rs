//! Rewrites system files of older versions: each old key gets its place of today, with its comments.
//!
//! The table of old keys is `OLD_KEYS`, by which files are read, too. A key moves within its stage, because there it
//! holds for that stage alone; so the new file gives every stage what the old one gave it, which is checked.

use std::collections::BTreeMap;

use toml::Table;
use toml_edit::{DocumentMut, Item, Key, RawString, TableLike, Value};

use crate::vehicle_table::{OLD_KEYS, OldKey, VEHICLE, distribute, scale};

/// A key without effect, and why.
pub(crate) const WITHOUT_EFFECT: (&str, &str, &str) =
    ("controller", "period_s", "has no effect: the scan period is 1 / rate_hz");

/// A file with the keys of today.
#[derive(Debug, PartialEq, Eq)]
pub struct Migration {
    /// The new text.
    pub text: String,
    /// What was changed, one line each; empty for a file that has no old key.
    pub changes: Vec<String>,
}

/// The text of a scenario or system file with the keys of today.
///
/// # Errors
/// A text that is no TOML, with its line, and one that would mean something else afterwards.
pub fn migrate(text: &str) -> Result<Migration, String> {
    let before = vehicle::parse(text)?;
    let mut document: DocumentMut = text.parse().map_err(|error| format!("{error}"))?;
    let (mut changes, mut taken) = (Vec::new(), Taken::default());
    let stages: Vec<String> = document.iter().map(|(name, _)| name.to_owned()).collect();
    for name in stages {
        taken.in_lines = document.get(&name).is_some_and(Item::is_table);
        let Some(stage) = document.get_mut(&name).and_then(Item::as_table_like_mut) else { continue };
        // Keys follow each other in their new place as they did in the old one.
        let keys: Vec<String> = stage.iter().map(|(key, _)| key.to_owned()).collect();
        let row = |key: &String| OLD_KEYS.iter().position(|old| old.stage == name && old.key == key);
        for row in keys.iter().filter_map(row) {
            let old = &OLD_KEYS[row];
            let Some((key, item)) = take(stage, old.key) else { continue };
            let place = [&[VEHICLE], old.place].concat();
            taken.row = row;
            move_to(stage, &place, &key, scaled(item, old), &mut taken, old.stage);
            changes.push(format!("{0}.{1} is now {0}.{2}", old.stage, old.key, place.join(".")));
        }
    }
    let (stage, key, why) = WITHOUT_EFFECT;
    if document.get_mut(stage).is_some_and(|stage| remove(stage, key)) {
        changes.push(format!("{}.{key} is removed: it {why}", WITHOUT_EFFECT.0));
    }
    let rewritten = || {
        let new = document.to_string();
        // The document ends its lines as Unix does.
        if text.contains("\r\n") { new.replace("\r\n", "\n").replace('\n', "\r\n") } else { new }
    };
    let text = if changes.is_empty() { text.to_owned() } else { rewritten() };
    let before = meaning(before)?;
    if !vehicle::parse(&text).and_then(meaning).is_ok_and(|after| after == before) {
        return Err("the rewritten file would mean something else; move its old keys by hand".to_owned());
    }
    Ok(Migration { text, changes })
}

/// The places that have a value of an old key, each with the row of that key; of two old keys for one place the later row
/// holds.
#[derive(Default)]
struct Taken {
    row: usize,
    rows: BTreeMap<String, usize>,
    /// Whether the stage is written in lines, not as a table in one line.
    in_lines: bool,
}

impl Taken {
    /// Whether a value of the present row holds at a place, which it then takes.
    fn take(&mut self, place: String) -> bool {
        let row = self.rows.entry(place).or_insert(self.row);
        *row = self.row.max(*row);
        *row == self.row
    }
}

/// What every stage gets from a file.
fn meaning(mut table: Table) -> Result<Table, String> {
    distribute(&mut table).map_err(|invalid| invalid.to_string())?;
    if let Some(toml::Value::Table(stage)) = table.get_mut(WITHOUT_EFFECT.0) {
        stage.remove(WITHOUT_EFFECT.1);
    }
    Ok(table)
}

/// Removes a key, with its comments.
fn take(table: &mut dyn TableLike, key: &str) -> Option<(Key, Item)> {
    let (key, item) = table.get_key_value(key).map(|(key, item)| (key.clone(), item.clone()))?;
    table.remove(key.get());
    Some((key, item))
}

/// Removes a key of a stage for good; whether it was there. Its comments go before the value that follows, else before the
/// stage.
fn remove(stage: &mut Item, key: &str) -> bool {
    let Some(table) = stage.as_table_like_mut() else { return false };
    let values = table.iter().filter(|(_, item)| item.is_value());
    let next = values.skip_while(|(name, _)| *name != key).nth(1).map(|(name, _)| name.to_owned());
    let Some((key, item)) = take(table, key) else { return false };
    let [lead, trail] = comments(&key, &item).map(Option::unwrap_or_default);
    let line = if trail.is_empty() { String::new() } else { format!("{}\n", trail.trim()) };
    let text = format!("{}{line}", lead.trim_end_matches([' ', '\t']));
    let after = |own: Option<&RawString>| own.and_then(RawString::as_str).unwrap_or_default().to_owned();
    if let Some(mut next) = next.and_then(|next| table.key_mut(&next)) {
        let own = after(next.leaf_decor().prefix());
        next.leaf_decor_mut().set_prefix(format!("{text}{own}"));
    } else if let Item::Table(table) = stage {
        let own = after(table.decor().prefix());
        table.decor_mut().set_prefix(format!("{own}{text}"));
    }
    true
}

/// Puts an item at a place below `table`, with the comments of its old key, unless what is there holds.
fn move_to(table: &mut dyn TableLike, place: &[&str], key: &Key, item: Item, taken: &mut Taken, path: &str) {
    let [name, rest @ ..] = place else { return };
    let path = format!("{path}.{name}");
    if taken.in_lines && (!rest.is_empty() || item.is_table_like()) {
        spread(table, name);
    }
    if let [_, ..] = rest {
        if !table.contains_key(name) {
            let inner = empty_like(table);
            table.insert(name, inner);
        }
        if let Some(inner) = table.get_mut(name).and_then(Item::as_table_like_mut) {
            move_to(inner, rest, key, item, taken, &path);
        }
        return;
    }
    match (table.get_mut(name), item) {
        (Some(there), mut item) if there.is_table_like() && item.is_table_like() => {
            let [lead, trail] = if take_header(there, &item) { [None, None] } else { comments(key, &item) };
            let Some(from) = item.as_table_like_mut() else { return };
            let names: Vec<String> = from.iter().map(|(name, _)| name.to_owned()).collect();
            for (index, name) in names.iter().enumerate() {
                let (Some((mut key, mut item)), Some(there)) = (take(from, name), there.as_table_like_mut())
                else {
                    continue;
                };
                if taken.in_lines {
                    without_blanks(&mut key, &mut item);
                }
                if let Some(lead) = lead.as_ref().filter(|_| index == 0) {
                    key.leaf_decor_mut().set_prefix(lead.clone());
                }
                if let (Some(trail), Item::Value(value)) = (&trail, &mut item)
                    && index + 1 == names.len()
                {
                    let own = value.decor().suffix().and_then(RawString::as_str).unwrap_or_default();
                    let both = format!("{}{trail}", own.trim_end());
                    value.decor_mut().set_suffix(both);
                }
                move_to(there, &[name], &key, item, taken, &path);
            }
        }
        (_, item) => {
            if !item.is_table_like() && !taken.take(path.clone()) {
                return;
            }
            note_values(&item, &path, taken);
            table.insert(name, item);
            if let Some(mut own) = table.key_mut(name) {
                *own.leaf_decor_mut() = key.leaf_decor().clone();
            }
        }
    }
}

/// Notes the places of all values in a table that has moved as a whole.
fn note_values(item: &Item, path: &str, taken: &mut Taken) {
    for (name, item) in item.as_table_like().into_iter().flat_map(TableLike::iter) {
        let path = format!("{path}.{name}");
        note_values(item, &path, taken);
        if !item.is_table_like() {
            taken.take(path);
        }
    }
}

/// A table that was made for others inside of it gets the header of one that is put into it; whether it did.
fn take_header(there: &mut Item, from: &Item) -> bool {
    let (Item::Table(there), Item::Table(from)) = (there, from) else { return false };
    let takes = there.is_implicit() && !from.is_implicit();
    if takes {
        there.set_implicit(false);
        *there.decor_mut() = from.decor().clone();
        there.set_position(from.position());
    }
    takes
}

/// A table in one line becomes one of lines, because those that come to it may have comments. One with comments inside
/// stays: they have no place among lines.
fn spread(table: &mut dyn TableLike, name: &str) {
    let Some((key, item)) = table.get_key_value(name) else { return };
    let [lead, trail] = comments(key, item);
    let Item::Value(Value::InlineTable(inline)) = item else { return };
    let mut inline = inline.clone();
    inline.decor_mut().clear();
    if inline.to_string().contains('#') || inline.is_empty() && (lead.is_some() || trail.is_some()) {
        return;
    }
    let mut lines = inline.into_table();
    lines.set_dotted(true);
    let names: Vec<String> = lines.iter().map(|(name, _)| name.to_owned()).collect();
    if let (Some(lead), Some(mut first)) = (lead, names.first().and_then(|name| lines.key_mut(name))) {
        first.leaf_decor_mut().set_prefix(lead);
    }
    if let (Some(trail), Some(last)) =
        (trail, names.last().and_then(|name| lines.get_mut(name)?.as_value_mut()))
    {
        last.decor_mut().set_suffix(trail);
    }
    table.insert(name, Item::Table(lines));
}

/// Takes away the blanks that a key and its value had in a table in one line.
fn without_blanks(key: &mut Key, item: &mut Item) {
    let is_blank = |text: Option<&RawString>| {
        text.and_then(RawString::as_str).is_some_and(|text| text.trim().is_empty())
    };
    if is_blank(key.leaf_decor().prefix()) {
        key.leaf_decor_mut().set_prefix("");
    }
    if let Item::Value(value) = item
        && is_blank(value.decor().suffix())
    {
        value.decor_mut().set_suffix("");
    }
}

/// The comments before and behind the name of a table, which goes into another one.
fn comments(key: &Key, item: &Item) -> [Option<String>; 2] {
    let (lead, trail) = match item {
        Item::Table(table) => (table.decor().prefix(), table.decor().suffix()),
        Item::Value(value) => (key.leaf_decor().prefix(), value.decor().suffix()),
        _ => (None, None),
    };
    let comment =
        |text: Option<&RawString>| text?.as_str().filter(|text| text.contains('#')).map(str::to_owned);
    [comment(lead), comment(trail)]
}

/// An empty table that is written as the one around it; one that is put into a table in one line becomes such a table.
fn empty_like(around: &dyn TableLike) -> Item {
    let mut table = toml_edit::Table::new();
    // Without values of its own it needs no header.
    table.set_implicit(true);
    table.set_dotted(around.is_dotted());
    Item::Table(table)
}

/// A value in the unit of today, with the comment behind it.
fn scaled(item: Item, old: &OldKey) -> Item {
    let Item::Value(value) = &item else { return item };
    let number = value.as_float().or_else(|| value.as_integer().map(|number| number as f64));
    match number.filter(|_| old.factor != 1.0) {
        Some(number) => {
            let mut new = Value::from(scale(number, old.factor));
            *new.decor_mut() = value.decor().clone();
            Item::Value(new)
        }
        None => item,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_comments_of_a_key_that_is_removed_stay() {
        let migrated = |old: &str| migrate(old).unwrap().text;
        let old =
            "[controller] # mine\n# of the scanner\nperiod_s = 0.1 # measured\n# far\nhorizon_s = 2.0\n";
        let new = "[controller] # mine\n# of the scanner\n# measured\n# far\nhorizon_s = 2.0\n";
        assert_eq!(migrated(old), new);
        let last = "rate_hz = 10.0\n\n[controller]\nhorizon_s = 2.0\n# of the scanner\nperiod_s = 0.1\n";
        assert_eq!(migrated(last), "rate_hz = 10.0\n\n# of the scanner\n[controller]\nhorizon_s = 2.0\n");
    }

    #[test]
    fn every_old_key_moves_with_its_comments_and_means_the_same() {
        let old = "# lab\nrate_hz = 10.0\n\n[estimator]\n# measured\nextra_latency_ms = 30 # with a stopwatch\n\n\
                   [controller]\ncruise_mps = 0.8 # slow\n# with bumpers\nbody_width_m = 0.6 # tape\nperiod_s = 0.1\n\n\
                   # of the scales\n[controller.parameters]\nmass_kg = 20\n\n[controller.bounds] # of the yard\n\
                   velocity_max_mps = 1.5\n\n[obstacles]\nbody_length_m = 0.7\n";
        let Migration { text, changes } = migrate(old).unwrap();
        let expected = "# lab\nrate_hz = 10.0\n\n[estimator]\n\n[estimator.vehicle]\n# measured\n\
                        command_delay_s = 0.03 # with a stopwatch\n\n[controller]\ncruise_mps = 0.8 # slow\n\n\
                        # of the scales\n[controller.vehicle]\n# with bumpers\nwidth_m = 0.6 # tape\nmass_kg = 20\n\n\
                        [controller.vehicle.bounds] # of the yard\nvelocity_max_mps = 1.5\n\n[obstacles]\n\n\
                        [obstacles.vehicle]\nlength_m = 0.7\n";
        assert_eq!(text, expected);
        assert_eq!(changes.len(), 6, "{changes:?}");
        assert!(
            changes
                .contains(&"estimator.extra_latency_ms is now estimator.vehicle.command_delay_s".to_owned())
        );
        let mut table: Table = text.parse().unwrap();
        assert_eq!(distribute(&mut table).unwrap(), [""; 0]);
        assert_eq!(migrate(&text).unwrap(), Migration { text, changes: Vec::new() });
    }

    #[test]
    fn keys_follow_each_other_as_they_did() {
        let rows = "body_length_m = 0.7\nbody_width_m = 0.5\ndeceleration_mps2 = 4";
        let text = format!("[controller]\n{rows}\nbounds = {{ velocity_max_mps = 1.5 }}\n");
        let Migration { text, changes } = migrate(&text).unwrap();
        let rows = "length_m = 0.7\nwidth_m = 0.5\nblocked_deceleration_mps2 = 4";
        let expected =
            format!("[controller]\n\n[controller.vehicle]\n{rows}\nbounds = {{ velocity_max_mps = 1.5 }}\n");
        assert_eq!(text, expected);
        assert!(
            changes[0].starts_with("controller.body_length_m ")
                && changes[3].starts_with("controller.bounds ")
        );
    }

    #[test]
    fn a_key_with_a_comment_goes_into_a_table_in_one_line() {
        for (key, expected) in [
            ("parameters", "vehicle.mass_kg = 20 # scales\n# with bumpers\nvehicle.width_m = 0.5 # tape\n"),
            ("vehicle", "vehicle.mass_kg = 20 # scales\n# with bumpers\nvehicle.width_m = 0.5 # tape\n"),
        ] {
            let first = format!("{key} = {{ mass_kg = 20 }} # scales\n");
            let text = format!("[controller]\n{first}# with bumpers\nbody_width_m = 0.5 # tape\n");
            assert_eq!(migrate(&text).unwrap().text, format!("[controller]\n{expected}"));
        }
        let text = "[controller]\nbody_length_m = 0.7 # tape\nparameters = { width_m = 0.5, mass_kg = 20 } # scales\n";
        let expected = "[controller]\n\n[controller.vehicle]\nlength_m = 0.7 # tape\nwidth_m = 0.5\nmass_kg = 20 # scales\n";
        assert_eq!(migrate(text).unwrap().text, expected);
        // Comments inside stay there, and one that has no place in the new text is not dropped.
        let of = |first: &str| {
            migrate(&format!("[controller]\nparameters = {first}\nbody_width_m = 0.5 # tape\n"))
        };
        let inside = of("{ # first\n mass_kg = 20, # scales\n}").unwrap().text;
        assert!(["# first", "# tape", "# scales"].iter().all(|comment| inside.contains(comment)), "{inside}");
        assert!(
            of("{} # none").unwrap_err().contains("by hand")
                || of("{} # none").unwrap().text.contains("# none")
        );
    }

    #[test]
    fn lines_end_as_they_did() {
        let text = "# lab\r\n[controller]\r\nbody_width_m = 0.6 # tape\r\n";
        let expected = "# lab\r\n[controller]\r\n\r\n[controller.vehicle]\r\nwidth_m = 0.6 # tape\r\n";
        assert_eq!(migrate(text).unwrap().text, expected);
    }

    #[test]
    fn each_row_of_the_table_moves_wherever_its_key_is_written() {
        for old in &OLD_KEYS {
            let value = match (old.key, old.place) {
                ("parameters", _) => "{ mass_kg = 20.0 }",
                ("bounds", _) => "{ velocity_max_mps = 0.9 }",
                ("extra_latency_ms", _) => "30",
                _ => "0.5",
            };
            let value = if old.place == ["blocked_deceleration_mps2"] { "4" } else { value };
            let (stage, key) = (old.stage, old.key);
            for text in [
                format!("[{stage}]\n{key} = {value} # here\n"),
                format!("{stage}.{key} = {value} # here\n"),
                format!(
                    "[{stage}]\n{key} = {value} # here\n[{stage}.vehicle]\nlength_m = 0.9\nwidth_m = 0.3\n"
                ),
                format!("{stage} = {{ {key} = {value} }} # here\n"),
            ] {
                let Migration { text: new, changes } =
                    migrate(&text).unwrap_or_else(|error| panic!("{text}{error}"));
                assert_eq!(changes.len(), 1, "{text}");
                assert!(new.contains("# here"), "{new}");
                assert!(new.parse::<Table>().unwrap()[stage].get(key).is_none(), "{new}");
                assert_eq!(distribute(&mut new.parse().unwrap()).unwrap(), [""; 0], "{new}");
            }
        }
    }

    #[test]
    fn comments_of_a_table_that_goes_into_another_one_stay() {
        let text = "[controller.vehicle]\nlength_m = 0.9\n\n# of the scales\n[controller.parameters] # two\nmass_kg = 20\n\
                    width_m = 0.5 # tape\n";
        let Migration { text, .. } = migrate(text).unwrap();
        let expected = "[controller.vehicle]\nlength_m = 0.9\n\n# of the scales\nmass_kg = 20\nwidth_m = 0.5 # tape # two\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn of_two_old_keys_for_one_value_the_one_that_held_is_kept() {
        let text = "[controller]\nbody_width_m = 0.6\n[controller.parameters]\nwidth_m = 0.5\n[controller.vehicle]\nwidth_m = 0.4\n";
        let Migration { text, .. } = migrate(text).unwrap();
        assert_eq!(text.parse::<Table>().unwrap()["controller"]["vehicle"]["width_m"].as_float(), Some(0.5));
        assert_eq!(text.matches("width_m").count(), 1, "{text}");
        // Also where it was written first.
        let text = "controller.parameters = { width_m = 0.5 }\ncontroller.body_width_m = 0.6\n";
        let Migration { text, .. } = migrate(text).unwrap();
        assert_eq!(text.parse::<Table>().unwrap()["controller"]["vehicle"]["width_m"].as_float(), Some(0.5));
    }

    #[test]
    fn a_file_of_today_stays_to_the_letter_and_a_wrong_one_is_refused() {
        let scenario = "name = 'lab'   # mine\n[robot]\nwidth_m = 0.5\n";
        assert_eq!(migrate(scenario).unwrap(), Migration { text: scenario.to_owned(), changes: Vec::new() });
        assert!(migrate("[controller\n").unwrap_err().starts_with("line 1"));
        assert!(
            migrate("[vehicle]\nwidth_m = 9\n")
                .unwrap_err()
                .starts_with("vehicle.width_m = 9 is not allowed")
        );
    }
}
