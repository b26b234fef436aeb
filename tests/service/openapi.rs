//! The OpenAPI document is true.

use std::collections::BTreeSet;

use proptest::bool::weighted;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{Config, TestRunner};
use realitysim::service::{OPENAPI, PARAMETERS};
use serde_json::{Map, Value, json};

use super::client::{get, get_with, post};
use super::{Served, with_captures};

fn document() -> Value {
    serde_json::from_str(OPENAPI).expect("JSON")
}

#[test]
fn its_parameters_are_those_of_the_code() {
    let document = document();
    let stated: Vec<(&str, &str)> = document["paths"]["/v1/view"]["get"]["parameters"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|parameter| (parameter["name"].as_str().unwrap_or(""), parameter["description"].as_str().unwrap_or("")))
        .collect();
    assert_eq!(stated, PARAMETERS);
    let batch: BTreeSet<&str> = document["components"]["schemas"]["View"]["properties"]
        .as_object()
        .expect("an object")
        .keys()
        .map(String::as_str)
        .collect();
    assert_eq!(batch, PARAMETERS.iter().map(|(name, _)| *name).collect());
}

#[test]
fn its_bounds_are_those_that_are_answered() {
    let served = Served::new("");
    let base = [("x", "0.22"), ("y", "0.2"), ("z", "0.5"), ("yaw_deg", "11"), ("pitch_deg", "20"), ("outside", "warn")];
    let asked = |name: &str, value: &str| {
        let others = base.iter().filter(|(own, _)| *own != name).map(|(own, value)| format!("{own}={value}"));
        let query: Vec<String> = others.chain([format!("{name}={value}")]).collect();
        get(served.address, &format!("/v1/view?{}", query.join("&")))
    };
    for parameter in document()["paths"]["/v1/view"]["get"]["parameters"].as_array().expect("a list") {
        let (name, schema) = (parameter["name"].as_str().expect("a name"), &parameter["schema"]);
        for (bound, beyond) in [("minimum", -1.0), ("maximum", 1.0)] {
            let Some(value) = schema[bound].as_f64() else { continue };
            let step = if schema["type"] == "integer" { 1.0 } else { 0.01 };
            let refused = asked(name, &(value + beyond * step).to_string());
            assert_eq!(refused.status, 400, "{name} beyond its {bound}: {}", refused.text());
            let answer = asked(name, &value.to_string());
            // The test's lens is wider than it is high: a view of 2048 rows has more columns than that.
            let is_too_large = (name, bound) == ("height", "maximum");
            let possible = if is_too_large { [400, 400] } else { [200, 404] };
            assert!(possible.contains(&answer.status), "{name} at its {bound}: {}", answer.text());
        }
        for value in schema["enum"].as_array().into_iter().flatten() {
            let answer = asked(name, value.as_str().expect("a name"));
            assert_eq!(answer.status, 200, "{name}={value}: {}", answer.text());
        }
        if parameter["required"] == true {
            let query: Vec<String> =
                base.iter().filter(|(own, _)| *own != name).map(|(n, v)| format!("{n}={v}")).collect();
            assert_eq!(get(served.address, &format!("/v1/view?{}", query.join("&"))).status, 400, "{name}");
        }
    }
}

#[test]
fn its_paths_answer_as_it_says_and_send_the_headers_that_it_names() {
    let (served, capture) = with_captures();
    assert_eq!(get(served.address, "/openapi.json").json(), document());
    let document = document();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            let answer = match (method.as_str(), path.as_str()) {
                ("get", "/v1/view") => get(served.address, "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&pitch_deg=20"),
                ("get", "/v1/capture" | "/v1/tags") => get(served.address, &format!("{path}?capture={capture}")),
                ("get", "/v1/frame" | "/v1/tag" | "/v1/explain" | "/v1/piece") => {
                    get(served.address, &format!("{path}?capture={capture}&frame=2"))
                }
                ("get", path) => get(served.address, path),
                (_, path) => post(served.address, path, r#"{"poses": [{"x": 0.2, "y": 0.2, "z": 0.5, "yaw_deg": 0}]}"#),
            };
            if ["/v1/live/frame", "/v1/live/order"].contains(&path.as_str()) {
                assert!([400, 404].contains(&answer.status), "no robot is watched: {}", answer.text());
                continue;
            }
            assert_eq!(answer.status, 200, "{method} {path}: {}", answer.text());
            let good = &operation["responses"]["200"];
            let kind = answer.header("content-type").split(';').next().unwrap_or("");
            assert!(good["content"].get(kind).is_some(), "{path}: {kind} is not in the document");
            let stated: BTreeSet<&str> =
                good["headers"].as_object().into_iter().flatten().map(|(name, _)| name.as_str()).collect();
            let only_sometimes =
                ["realitysim-expected-error-px", "realitysim-effects", "realitysim-warning", "realitysim-unreadable"];
            let always = stated.iter().filter(|name| !only_sometimes.contains(name));
            always.for_each(|name| assert!(answer.headers.contains_key(*name), "{path}: {name} is not sent"));
            let sent = answer.headers.keys().filter(|name| name.starts_with("realitysim-"));
            sent.for_each(|name| assert!(stated.contains(name.as_str()), "{path}: {name} is not in the document"));
            let wrong =
                if method == "get" { post(served.address, path, "{}") } else { get_with(served.address, path, "") };
            assert!(wrong.status == 405 && operation["responses"].get("405").is_some(), "{path}");
            assert_eq!(wrong.header("allow"), if method == "get" { "GET, HEAD" } else { "POST" }, "{path}");
        }
    }
}

/// A value that the document allows for a parameter, as JSON.
fn value_of(name: &str, schema: &Value, lenses: &[String]) -> BoxedStrategy<Value> {
    let bound = |which: &str| schema[which].as_f64().unwrap_or_else(|| panic!("{name} has no {which}"));
    match schema["type"].as_str() {
        Some("number") => (bound("minimum")..=bound("maximum")).prop_map(|value| json!(value)).boxed(),
        Some("integer") => {
            let whole = (bound("minimum") as u64..=bound("maximum") as u64, any::<bool>());
            whole.prop_map(|(value, as_float)| if as_float { json!(value as f64) } else { json!(value) }).boxed()
        }
        _ => match (name, schema["enum"].as_array()) {
            (_, Some(choices)) => select(choices.clone()).boxed(),
            ("lens", _) => select(lenses.to_vec()).prop_map(Value::from).boxed(),
            _ => panic!("{name}: what is possible?"),
        },
    }
}

/// The parameters of a view, some of those that may be left out missing.
fn view_of(document: &Value, lenses: &[String]) -> BoxedStrategy<Map<String, Value>> {
    let parameters = document["paths"]["/v1/view"]["get"]["parameters"].as_array().expect("a list");
    // The service has no scene; a height beside a width keeps all that are possible within the pixels of a view.
    let parameters = parameters.iter().filter(|parameter| parameter["name"] != "scene");
    let one = |parameter: &Value| {
        let name = parameter["name"].as_str().expect("a name").to_owned();
        let present = if parameter["required"] == true { 1.0 } else { 0.3 };
        let value = value_of(&name, &parameter["schema"], lenses);
        (weighted(present), value).prop_map(move |(present, value)| present.then(|| (name.clone(), value)))
    };
    let with_width = |mut view: Map<String, Value>| {
        if view.contains_key("height") {
            view.entry("width").or_insert(json!(640));
        }
        view
    };
    parameters
        .map(one)
        .collect::<Vec<_>>()
        .prop_map(move |values| with_width(values.into_iter().flatten().collect()))
        .boxed()
}

#[test]
fn what_it_allows_is_not_refused() {
    let served = Served::new("");
    let document = document();
    let lenses =
        get(served.address, "/v1/info").json()["lenses"].as_object().expect("lenses").keys().cloned().collect();
    let lenses: Vec<String> = lenses;
    let mut runner = TestRunner::new(Config { cases: 10, failure_persistence: None, ..Config::default() });
    let view = view_of(&document, &lenses);
    let asked = runner.run(&(view.clone(), view, 1..4u32), |(first, second, count)| {
        let mut query = form_urlencoded::Serializer::new(String::new());
        for (name, value) in &first {
            query.append_pair(name, &value.as_str().map_or_else(|| value.to_string(), str::to_owned));
        }
        let answer = get(served.address, &format!("/v1/view?{}", query.finish()));
        prop_assert!([200, 404].contains(&answer.status), "{first:?}: {}", answer.text());
        for batch in [
            json!({ "poses": [first, second] }),
            json!({ "from": first, "to": second, "count": count }),
            json!({ "from": first, "to": second, "count": f64::from(count) }),
        ] {
            let answer = post(served.address, "/v1/views", &batch.to_string());
            prop_assert!(answer.status == 200, "{batch}: {}", answer.text());
        }
        Ok(())
    });
    asked.unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn batches_that_it_does_not_allow_are_refused() {
    let served = Served::new("");
    let pose = json!({ "x": 0.2, "y": 0.2, "z": 0.5, "yaw_deg": 0 });
    for batch in [
        json!({}),
        json!({ "poses": [pose], "from": pose, "to": pose, "count": 2 }),
        json!({ "from": pose, "to": pose }),
        json!({ "poses": [] }),
        json!({ "poses": [{ "x": 0.2, "y": 0.2, "z": 0.5 }] }),
        json!({ "poses": [pose], "colour": "red" }),
    ] {
        assert_eq!(post(served.address, "/v1/views", &batch.to_string()).status, 400, "{batch}");
    }
}
