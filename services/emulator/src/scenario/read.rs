//! From a TOML table to a scenario, with errors that name the key.

use toml::{Table, Value};
use vehicle::{Invalid, read};

use super::obstacle::ObstacleFile;
use super::{Scenario, ScenarioObstacle};

/// The scenario in `table`, with types and names of keys checked, numbers not yet.
pub(super) fn scenario(table: Table) -> Result<Scenario, Invalid> {
    table.get("obstacle").map_or(Ok(()), obstacles)?;
    read(table)
}

/// Obstacles alone: serde would report what is wrong with one without its key.
fn obstacles(value: &Value) -> Result<(), Invalid> {
    let tables = value.as_array().ok_or_else(|| Invalid::new("obstacle", value, "tables [[obstacle]]"))?;
    tables.iter().enumerate().try_for_each(|(index, value)| {
        let name = format!("obstacle[{index}]");
        let table =
            value.as_table().ok_or_else(|| Invalid::new(&name, value, format!("a table [{name}]")))?;
        let obstacle = read::<ObstacleFile>(table.clone()).and_then(ScenarioObstacle::try_from);
        obstacle.map(drop).map_err(|error| error.within(&name))
    })
}
