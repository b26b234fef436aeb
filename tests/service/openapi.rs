//! The OpenAPI document is true.

use std::collections::BTreeSet;

use realitysim::service::{OPENAPI, PARAMETERS};
use serde_json::Value;

use super::Served;
use super::client::{get, get_with, post};

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
            // 4096 x 3072 is more than all pixels of a view.
            if !(matches!(name, "width" | "height") && bound == "maximum") {
                let answer = asked(name, &value.to_string());
                assert!(answer.status == 200 || answer.status == 404, "{name} at its {bound}: {}", answer.text());
            }
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
    let served = Served::new("");
    assert_eq!(get(served.address, "/openapi.json").json(), document());
    let document = document();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            let answer = match (method.as_str(), path.as_str()) {
                ("get", "/v1/view") => get(served.address, "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&pitch_deg=20"),
                ("get", path) => get(served.address, path),
                (_, path) => post(served.address, path, r#"{"poses": [{"x": 0.2, "y": 0.2, "z": 0.5, "yaw_deg": 0}]}"#),
            };
            assert_eq!(answer.status, 200, "{method} {path}: {}", answer.text());
            let good = &operation["responses"]["200"];
            let kind = answer.header("content-type").split(';').next().unwrap_or("");
            assert!(good["content"].get(kind).is_some(), "{path}: {kind} is not in the document");
            let stated: BTreeSet<&str> =
                good["headers"].as_object().into_iter().flatten().map(|(name, _)| name.as_str()).collect();
            let only_sometimes = ["realitysim-effects", "realitysim-warning", "realitysim-unreadable"];
            let always = stated.iter().filter(|name| !only_sometimes.contains(name));
            always.for_each(|name| assert!(answer.headers.contains_key(*name), "{path}: {name} is not sent"));
            let sent = answer.headers.keys().filter(|name| name.starts_with("realitysim-"));
            sent.for_each(|name| assert!(stated.contains(name.as_str()), "{path}: {name} is not in the document"));
            let wrong =
                if method == "get" { post(served.address, path, "{}") } else { get_with(served.address, path, "") };
            assert!(wrong.status == 405 && operation["responses"].get("405").is_some(), "{path}");
        }
    }
}
