use super::*;
use proptest::prelude::*;

fn any_key() -> impl Strategy<Value = String> {
    let mut all = Vec::new();
    keys(&Layers::maneuver("lane_change").unwrap().values, "", &mut all);
    prop_oneof![proptest::sample::select(all), "[a-z_.]{0,20}"]
}

fn any_value() -> impl Strategy<Value = String> {
    prop_oneof![
        any::<f64>().prop_map(|number| format!("{number:?}")),
        any::<i64>().prop_map(|number| number.to_string()),
        "(true|nan|-inf|''|\\[\\]|\\{\\}|\\[1, 'a'\\]|\\{min=1.0\\})",
        ".{0,30}",
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]
    #[test]
    fn no_text_makes_the_parser_panic_or_wordy(
        text in ".{0,200}", key in any_key(), value in any_value(),
    ) {
        for layer in [text, format!("{key} = {value}")] {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            let result = layers.add_document("x", &layer).and_then(|()| layers.resolve());
            if let Err(error) = result {
                prop_assert!(!error.to_string().is_empty());
            }
        }
        let mut layers = Layers::maneuver("roundabout").unwrap();
        let _ = layers.set(&format!("{key}={value}")).and_then(|()| layers.resolve());
    }
}

fn message(result: Result<impl std::fmt::Debug, ConfigError>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn a_steering_rate_of_the_user_bounds_the_gate_s_and_not_the_excitation_s() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("car.toml");
    std::fs::write(&file, "base = 'f1tenth'\nname = 'mine'\nsteering_rate_radps = 1.0\n").unwrap();
    let limit = |sets: &[&str]| {
        let mut layers = Layers::maneuver("smooth_lane").unwrap();
        layers.set_vehicle("--vehicle", file.to_str().unwrap()).unwrap();
        sets.iter().for_each(|set| layers.set(set).unwrap());
        layers.resolve().unwrap().vehicle.safety.steering_rate_limit_radps
    };
    assert_eq!(limit(&[]), 1.0);
    assert_eq!(limit(&["vehicle.steering_rate_radps=9.0"]), 3.2);
    assert_eq!(limit(&["vehicle.safety.steering_rate_limit_radps=2.0"]), 2.0);
    assert_eq!(limit(&["law_preset=excitation"]), 3.2);
}

#[test]
fn an_interval_around_a_value_that_another_layer_replaces_is_none_of_the_other_value() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("car.toml");
    let text = "base = 'ackermann'\nname = 'mine'\nwheelbase_m = 2.6\nsteering_delay_s = 0.14\n\
                [uncertainty]\nidentified = true\nwheelbase_m = [2.59, 2.61]\nsteering_delay_s = [0.13, 0.15]\n";
    let resolve = |text: &str, sets: &[&str]| {
        std::fs::write(&file, text).unwrap();
        let mut layers = Layers::maneuver("smooth_lane").unwrap();
        layers.set_vehicle("--vehicle", file.to_str().unwrap()).unwrap();
        sets.iter().for_each(|set| layers.set(set).unwrap());
        layers.resolve()
    };
    let stated = |sets: &[&str]| {
        let uncertainty = resolve(text, sets).unwrap().vehicle.uncertainty;
        uncertainty.within.keys().cloned().collect::<Vec<_>>()
    };
    assert_eq!(stated(&[]), ["steering_delay_s", "wheelbase_m"]);
    assert_eq!(stated(&["vehicle.steering_delay_s=0.18"]), ["wheelbase_m"]);
    assert_eq!(stated(&["vehicle.steering_delay_s=0.145"]), ["steering_delay_s", "wheelbase_m"]);
    // The file's own must fit each other.
    let why = message(resolve(&text.replace("= 2.6\n", "= 2.7\n"), &[]));
    assert!(why.contains("vehicle.uncertainty.wheelbase_m"), "{why}");
}

#[test]
fn a_vehicle_that_is_slower_than_every_maneuver_is_a_vehicle() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("agv.toml");
    let text = "base = 'ackermann'\nname = 'agv'\nspeed_limit_mps = 0.3\n";
    std::fs::write(&file, text).unwrap();
    let vehicle = Layers::vehicle_of_file(file.to_str().unwrap()).unwrap();
    assert_eq!(vehicle.speed_limit_mps, 0.3);
}

#[test]
fn every_maneuver_resolves() {
    for name in maneuver_names() {
        let config = Layers::maneuver(name).unwrap().resolve().unwrap();
        assert_eq!(config.maneuver, name);
    }
}

#[test]
fn a_resolved_configuration_is_a_layer_that_changes_nothing() {
    let config = Layers::maneuver("roundabout").unwrap().resolve().unwrap();
    let text = toml::to_string(&config).unwrap();
    let mut again = Layers::maneuver("roundabout").unwrap();
    again.add_document("resolved.toml", &text).unwrap();
    assert_eq!(again.resolve().unwrap(), config);
}

#[test]
fn mistakes_name_place_key_and_way_out() {
    let check = |text: &str, parts: &[&str]| {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        let result = layers.add_document("my.toml", text).and_then(|()| layers.resolve());
        let message = message(result);
        for part in parts {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
        assert!(!message.contains('\n'), "{message:?}");
    };
    check(
        "\n[learning]\nepisods = 3",
        &["my.toml:3", "learning.episods", "mean learning.episodes"],
    );
    check("[learning]\nepisodes = 'x'", &["my.toml:2", "learning.episodes", "integer", "string"]);
    check("[learning]\nepisodes = 0", &["my.toml:2", "learning.episodes", "0", "[1, 100000]"]);
    check("[learning\n", &["my.toml:1"]);
    check("[run]\nalphas = [0.5, 1.5]", &["my.toml:2", "run.alphas", "1.5", "(0, 1]"]);
    check("x_m,y_m\n0,0\n", &["my.toml:", "a TOML file is wanted here"]);
    check("[learning]\ntuner = 'sarsa'", &["my.toml:2", "learning.tuner", "sarsa"]);
    check("[grid]\nkv = { min = 3.0, max = 1.0 }", &["my.toml:2", "grid.kv", "reversed"]);
    check("[grid.kv]\nstep = 0.0", &["my.toml:2", "grid.kv.step"]);
    check("objective = 'paths'", &["my.toml:1", "objective.name", "mean path"]);
    check("maneuver = 'other'", &["my.toml:1", "maneuver", "cannot be changed"]);
    check("[path]\npoints = [[0, 0], [1, 0]]", &["my.toml:2", "path.points", "pieces"]);
    check("[path]\npieces = []", &["my.toml:2", "path.pieces"]);
    check("[path]\npieces = [{ kind = 'loop' }]", &["my.toml:2", "path.pieces", "loop"]);
    check("[vehicle]\nmass_kg = 0.0", &["my.toml:2", "vehicle.mass_kg", "(0, 100000]"]);
    check(
        "[vehicle]\nmodel = 'dynamic'\nfront_axle_to_cg_m = 2.875",
        &["my.toml:3", "vehicle.front_axle_to_cg_m", "less than the wheelbase, 2.875"],
    );
    check(
        "[vehicle]\nmodel = 'dynamic'\ncornering_stiffness_rear_npr = 1e4",
        &["my.toml:3", "vehicle.cornering_stiffness_rear_npr", "unstable from 5.4 m/s"],
    );
    check("[noise]\nposition_sd_m = nan", &["my.toml:2", "noise.position_sd_m", "NaN"]);
    check(
        "objective = 'weighted'\n[ranking]\nmax_ticks = 1000",
        &["objective.settings.mse_scale", "375000 ticks", "give a scale"],
    );
}

#[test]
fn single_keys_take_toml_or_a_bare_word() {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set("learning.episodes = 3").unwrap();
    layers.set("learning.tuner=q").unwrap();
    layers.set("objective=path").unwrap();
    layers.set("grid.kv={min=0.1,max=0.1,step=1.0}").unwrap();
    assert!(message(layers.set("learning.episodes")).contains("no '='"));
    assert!(message(layers.set("nothing.here=1")).contains("unknown key"));
    let config = layers.resolve().unwrap();
    assert_eq!(config.learning.episodes, 3);
    assert_eq!(config.learning.tuner, "q");
    assert_eq!(config.objective.name, "path");
    assert_eq!(config.grid().len(), 125);
}

#[test]
fn a_manoeuvre_s_own_file_is_a_layer_that_changes_nothing() {
    for name in maneuver_names() {
        let file = preset(&format!("maneuvers/{name}.toml")).unwrap();
        let mut layers = Layers::maneuver(name).unwrap();
        layers.add_document("mine.toml", file.text).unwrap();
        assert_eq!(layers.resolve().unwrap(), Layers::maneuver(name).unwrap().resolve().unwrap());
    }
}

#[test]
fn an_unknown_maneuver_names_the_nearest() {
    assert!(message(Layers::maneuver("lanechange")).contains("did you mean lane_change?"));
    assert!(message(Layers::maneuver("xyz")).contains("lane_change, roundabout"));
    assert!(message(Layers::maneuver("path")).contains("there are circuit"));
}

#[test]
fn a_tuner_s_setting_has_a_range_and_keeps_to_it() {
    let mut config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    let problem = |config: &RunConfig| crate::validate::validate(config).unwrap_err();
    config.tuner.settings.0.insert("population".to_owned(), Value::Integer(1));
    let (key, why) = problem(&config);
    assert!(key == "tuner.ranges.population" && why.contains("is missing"), "{key} {why}");
    config.tuner.ranges.insert("population".to_owned(), [2.0, 256.0]);
    let (key, why) = problem(&config);
    assert_eq!((&*key, &*why), ("tuner.settings.population", "is 1, but must lie in [2, 256]"));
    config.tuner.settings.0.insert("population".to_owned(), Value::Float(2.0));
    crate::validate::validate(&config).unwrap();
}

#[test]
fn a_tuner_s_setting_must_be_what_its_file_holds() {
    let of = |set: &str| {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("learning.tuner=random").unwrap();
        layers.set(&format!("tuner.settings.{set}"))?;
        layers.resolve()
    };
    for (set, wants) in [
        ("drives=abc", "must be an integer, but is a string"),
        ("drives=2.5", "must be an integer, but is a float"),
        ("drives=0", "is 0, but must lie in [1, 10000]"),
        ("draw=3", "must be a string, but is an integer"),
        ("draw=gird", "is \"gird\", and must be one of grid, continuous"),
    ] {
        let told = message(of(set));
        let key = format!("tuner.settings.{}", set.split_once('=').unwrap().0);
        assert!(told.contains(&key) && told.contains(wants), "{set}: {told}");
    }
}

/// A configuration that was resolved once, such as that of a run which is resumed, comes without the layers' checks.
#[test]
fn a_resolved_tuner_s_settings_are_checked_as_well() {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set("learning.tuner=random").unwrap();
    let config = layers.resolve().unwrap();
    let text = toml::to_string(&config).unwrap();
    assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
    for (written, wants) in [
        ("drives = \"abc\"", "is \"abc\", but must be a number in [1, 10000]"),
        ("drives = 2.5", "is 2.5, but must be a whole number in [1, 10000]"),
        ("drives = nan", "is NaN, but must lie in [1, 10000]"),
    ] {
        let told = message(RunConfig::from_resolved(&text.replace("drives = 60", written)));
        assert!(told.contains("tuner.settings.drives"), "{written}: {told}");
        assert!(told.contains(wants), "{written}: {told}");
    }
}
