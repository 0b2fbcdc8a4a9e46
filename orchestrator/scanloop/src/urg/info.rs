//! `scanloop urg info`.

use console::exit::{Exit, Failure};
use console::output::data;
use serde_json::{Map, Value, json};
use urg::{SensorParameters, fields};

use super::arguments::InfoArguments;
use super::scanner::Scanner;

/// Prints what a scanner tells about itself.
pub(super) fn info(arguments: &InfoArguments) -> anyhow::Result<Exit> {
    let source = Scanner::identify(&arguments.place)?;
    let identity = source.identity();
    let Some(parameters) = &identity.parameters else {
        return Err(
            Failure { exit: Exit::NotReached, message: "the scanner has no parameters".to_owned() }.into()
        );
    };
    if arguments.json {
        let place = arguments.place.device.as_ref().map(|path| path.display().to_string());
        let mut value = parameters_json(parameters);
        value["place"] = json!(place.or_else(|| arguments.place.tcp.clone()));
        value["version"] = object(&identity.version);
        value["state"] = object(&identity.state);
        data(&serde_json::to_string_pretty(&value)?)?;
        return Ok(Exit::Done);
    }
    let lines: Vec<String> = identity.lines().map(|(key, value)| format!("{key}  {value}")).collect();
    data(&format!("{}\n{}", lines.join("\n"), summary(parameters)))?;
    Ok(Exit::Done)
}

/// First and last angle [deg].
fn view_deg(parameters: &SensorParameters) -> [f64; 2] {
    [parameters.first, parameters.last].map(|step| parameters.yaw_rad(f64::from(step)).to_degrees())
}

fn summary(parameters: &SensorParameters) -> String {
    let SensorParameters { model, min_mm, max_mm, steps, first, last, front, rpm } = parameters;
    let [right, left] = view_deg(parameters);
    let fit = match parameters.require_fit(None, 0) {
        Ok(()) => "covers what the stages analyse".to_owned(),
        Err(error) => error.to_string(),
    };
    format!(
        "model     {model}\nranges    {min_mm} to {max_mm} mm\nview      {right:.1} to {left:.1} deg, steps {first} to \
         {last} of {steps}, ahead is {front}\nrate      {:.2} scans a second ({rpm} rpm)\nfit       {fit}",
        parameters.rate_hz(0)
    )
}

fn parameters_json(parameters: &SensorParameters) -> Value {
    let SensorParameters { model, min_mm, max_mm, steps, first, last, front, .. } = parameters;
    let [right_deg, left_deg] = view_deg(parameters);
    json!({
        "model": model, "min_mm": min_mm, "max_mm": max_mm, "steps": steps, "first": first, "last": last,
        "front": front, "right_deg": right_deg, "left_deg": left_deg, "rate_hz": parameters.rate_hz(0),
        "fits": parameters.require_fit(None, 0).is_ok(),
    })
}

fn object(text: &[u8]) -> Value {
    Value::Object(fields(text).map(|(key, value)| (key, Value::String(value))).collect::<Map<_, _>>())
}
