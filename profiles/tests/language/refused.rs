//! What is said about a bad script, and about a folder that holds one.

use profiles::{Context, LoadError, Script, load_folder};

use crate::{CONTEXT, HEAD};

#[test]
fn a_voltage_beyond_the_rig_is_refused_with_its_line() {
    let text = format!("{HEAD}[[step]]\nvoltage_v = 12\nfor_s = 1\n\n[[step]]\nvoltage_v = -20.5\nfor_s = 1\n");
    let script = Script::parse(&text, "a/b.toml").expect("parses");
    let error = script.compile(&CONTEXT).expect_err("20.5 V on a rig of 20 V");
    assert_eq!((error.file.as_str(), error.line), ("a/b.toml", 13));
    assert!(error.to_string().contains("-20.5") && error.to_string().contains("20 V"), "{error}");
    for u_max_v in [0.0, -24.0, f64::NAN, f64::INFINITY] {
        assert!(script.compile(&Context { u_max_v, seed: 0, hands: profiles::Hands::Rig }).is_err(), "{u_max_v}");
    }
}

/// Every kind of mistake: the steps (appended to HEAD, so that line 9 is their first), the line, and a part of the message.
const BAD_STEPS: &[(&str, usize, &str)] = &[
    ("", 1, "at least one [[step]]"),
    ("[[step]]\nvoltage_v = \n", 10, ""),
    ("[[step]]\nfor_s = 1\nspeed = 3\n", 11, "unknown field `speed`"),
    ("[[step]]\nvoltage_v = \"2\"\nfor_s = 1\n", 10, "a number, or"),
    ("[[step]]\nvoltage_v = true\nfor_s = 1\n", 10, "a number, or"),
    ("[[step]]\nvoltage_v = nan\nfor_s = 1\n", 10, "finite"),
    ("[[step]]\nvoltage_v = 1\nvoltage_v = 2\nfor_s = 1\n", 11, "duplicate"),
    ("[[step]]\nvoltage_v = 1\nflow_ml_s = 2\nfor_s = 1\n", 11, "only one of"),
    ("[[step]]\nvoltage_u_max = 1.2\nfor_s = 1\n", 10, "-1 .. 1, got 1.2"),
    ("[[step]]\nbrake = \"ajar\"\nfor_s = 1\n", 10, "ajar"),
    ("[[step]]\nvoltage_v = 1\n", 9, "`for_s`, or `until`"),
    ("[[step]]\nfor_s = 0\n", 10, "`for_s` must lie within"),
    ("[[step]]\nfor_s = -1\n", 10, "got -1"),
    ("[[step]]\nuntil = []\ntimeout_s = 1\n", 10, "at least one condition"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", above = 1 }]\n", 10, "needs a `timeout_s`"),
    ("[[step]]\ntimeout_s = 1\n", 10, "belongs to `until`"),
    ("[[step]]\nfor_s = 1\nuntil = [{ channel = \"angle_deg\", above = 1 }]\n", 11, "got both"),
    ("[[step]]\nuntil = [\n  { channel = \"angle\", above = 1 },\n]\ntimeout_s = 1\n", 11, "unknown variant `angle`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\" }]\ntimeout_s = 1\n", 10, "exactly one of"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", above = 1, below = 2 }]\ntimeout_s = 1\n", 10, "exactly one of"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", rate_below = 1 }]\ntimeout_s = 1\n", 10, "`window_s`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1 }]\ntimeout_s = 1\n", 10, "`for_s`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", for_s = 1 }]\ntimeout_s = 1\n", 10, "`steady_within`"),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1, for_s = 1, above = 3 }]\ntimeout_s = 1\n",
        10,
        "exactly one of",
    ),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 0, for_s = 1 }]\ntimeout_s = 2\n",
        10,
        "`steady_within` must lie within",
    ),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1, for_s = 2 }]\ntimeout_s = 2\n",
        11,
        "can't be met within `timeout_s` = 2",
    ),
    ("[[step]]\nuntil = [{ channel = \"pressure1_bar\", above = 300 }]\ntimeout_s = 2\n", 10, "300 kPa are 3 bar"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", below = -400 }]\ntimeout_s = 2\n", 10, "-90 .. 90, got -400"),
    ("[[step]]\nangle_deg = 3\nfor_s = 1\n", 10, "needs `fixture`"),
    ("[[step]]\nfixture = \"glued\"\nfor_s = 1\n", 10, "glued"),
    ("[[step]]\nfixture = \"clamped\"\nfor_s = 1\n", 10, "`angle_deg` is missing"),
    ("[[step]]\nfixture = \"clamped\"\nangle_deg = 50\nfor_s = 1\n", 11, "-45 .. 45, got 50"),
    ("[[step]]\nfixture = \"free\"\nangle_deg = 5\nfor_s = 1\n", 11, "has no `angle_deg`"),
    ("[[step]]\nfixture = \"driven\"\nangle_deg = 5\nrate_deg_s = 0\n", 12, "`rate_deg_s` must lie within"),
    ("[[step]]\nfixture = \"driven\"\nangle_deg = 5\nrate_deg_s = 1\nfor_s = 3\n", 13, "remove `for_s`"),
    ("[[step]]\nfixture = \"filled\"\nangle_deg = 5\npressure1_bar = 9\npressure2_bar = 2\nfor_s = 1\n", 12, "got 9"),
    ("[[step]]\nfixture = \"released\"\nangle_deg = 5\nrelease_ml_s = -1\nfor_s = 1\n", 12, "got -1"),
    ("[[step]]\nfixture = \"pump-bench\"\npressure1_bar = 2\nfor_s = 1\n", 10, "`pressure2_bar` is missing"),
    ("[[step]]\nrepeat = 0\n[[step.step]]\nfor_s = 1\n", 10, "at least 1, got 0"),
    ("[[step]]\nrepeat = -2\n[[step.step]]\nfor_s = 1\n", 10, "-2"),
    ("[[step]]\nrepeat = 2\n", 10, "needs inner steps"),
    ("[[step]]\nrepeat = 2\nfor_s = 1\n[[step.step]]\nfor_s = 1\n", 11, "inner [[step.step]]"),
    ("[[step]]\nrepeat = 4000000000\n[[step.step]]\nfor_s = 1\n", 11, "more than"),
    ("[[step]]\nrepeat = 2\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = \"$a\"\n", 9, "got several"),
    (
        "[[step]]\nrepeat = 2\nstop_when = [{ channel = \"angle_deg\", rate_below = 1, window_s = 1 }]\n[[step.step]]\nfor_s = 1\n",
        11,
        "exactly one of",
    ),
    ("[[step]]\nfor_s = 1\nstop_when = [{ channel = \"angle_deg\", above = 1 }]\n", 11, "belongs to `repeat`"),
    ("[[step]]\nfor_s = 1\n[[step.step]]\nfor_s = 1\n", 9, "need `repeat` or `for_each`"),
    ("[[step]]\nvoltage_u_max = 60\nfor_s = 1\n", 10, "it is a fraction: 60 % are 0.6"),
    ("[[step]]\nfor_s = 100000\n", 10, "100000 ms are 100 s"),
    (
        "[[step]]\nfixture = \"filled\"\nangle_deg = 5\npressure1_bar = 500\npressure2_bar = 2\nfor_s = 1\n",
        12,
        "`pressure1_bar` must lie within 0.1 .. 8, got 500; write it in bar: 500 kPa are 5 bar, 500 mbar are 0.5 bar",
    ),
    (
        "[[step]]\nfixture = \"pump-bench\"\npressure1_bar = 40\npressure2_bar = 2\nfor_s = 1\n",
        11,
        "40 psi are 2.757903 bar",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 10, step = 3 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "set `to` to 9 or 12",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = -1, step = 3 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "set `to` to 0 or -3",
    ),
    ("[[step]]\nfor_each = { a = { from = 0, to = 10, step = -5 } }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "got -5"),
    (
        "[[step]]\nfor_each = { a = { from = 1, to = 1, count = 2 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "must differ",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, count = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "2 .. 10000, got 1",
    ),
    ("[[step]]\nfor_each = { a = { from = 0, to = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "one of `step`"),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, step = 1, count = 2 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "one of `step`",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, step = 1e-6 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "more than 10000",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, till = 1, step = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "unknown field `till`",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 1, to = 3, step = 1 }, b = [1, 2] }\n[[step.step]]\nvoltage_v = \"$a\"\nfor_s = \"$b\"\n",
        10,
        "`a` has 3, `b` 2",
    ),
    ("[[step]]\nfor_s = 1\n[envelope]\npressure_max_bar = 500\n", 12, "500 kPa are 5 bar"),
    ("[[step]]\nfor_s = 1\n[envelope]\nangle_max_deg = 0\n", 12, "0.1 .. 90, got 0"),
    (
        "[[step]]\nfor_s = 1\n[envelope]\npressure_max_bar = 2\npressure_min_bar = 3\n",
        11,
        "below `pressure_max_bar` = 2",
    ),
    ("[[step]]\nfor_s = 1\n[envelope]\nslew_max_v_s = 2\n", 12, "unknown field `slew_max_v_s`"),
    ("[[step]]\nfor_s = 1\n[envelope]\nangle_max_deg = \"$a\"\n", 12, "in scope: none"),
    ("[[step]]\nfor_each = {}\n[[step.step]]\nfor_s = 1\n", 10, "at least one list"),
    ("[[step]]\nfor_each = { a = [] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "at least 1"),
    (
        "[[step]]\nfor_each = { a = [1, 2], b = [1] }\n[[step.step]]\nvoltage_v = \"$b\"\nfor_s = \"$a\"\n",
        10,
        "`a` has 2, `b` 1",
    ),
    ("[[step]]\nfor_each = { a = [1, inf] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "finite"),
    ("[[step]]\nfor_each = { a = [1, \"x\"] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, ""),
    ("[[step]]\nfor_each = { A = [1] }\n[[step.step]]\nfor_s = \"$A\"\n", 10, "a-z, 0-9"),
    ("[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = 1\n", 10, "no inner step uses"),
    ("[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = \"$b\"\n", 12, "in scope: a"),
    (
        "[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_each = { a = [1] }\n[[step.step.step]]\nfor_s = \"$a\"\n",
        12,
        "already that of",
    ),
    ("[[step]]\nfor_s = \"$a\"\n", 10, "in scope: none"),
    (
        "[[step]]\nvoltage_v = 1\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        10,
        "beside `random`",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.3, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        12,
        "[0.3, 0.2]",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 1.5\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        14,
        "got 1.5",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0.6\nbypass_open_share = 0.6\nguard_deg = 20\n",
        16,
        "got 1.2",
    ),
    ("[[step]]\n[step.random]\ntotal_s = 1\n", 10, "missing field"),
];

#[test]
fn a_bad_step_is_refused_with_file_line_and_reason() {
    for (steps, line, reason) in BAD_STEPS {
        let error = Script::parse(&format!("{HEAD}{steps}"), "dir/bad.toml").expect_err(steps);
        assert_eq!(error.line, *line, "{error}\n{steps}");
        assert!(error.what.contains(reason), "{error}\nexpected: {reason}\n{steps}");
        assert!(!error.what.is_empty());
        assert!(error.to_string().starts_with(&format!("dir/bad.toml:{line}: ")), "{error}");
    }
}

#[test]
fn a_bad_head_is_refused_with_file_line_and_reason() {
    let good = format!("{HEAD}[[step]]\nfor_s = 1\n");
    Script::parse(&good, "t.toml").expect("the head is good");
    for (from, to, line, reason) in [
        ("name = \"t\"", "name = \"../t\"", 1, "a-z, 0-9"),
        ("name = \"t\"", "name = \"\"", 1, "a-z, 0-9"),
        ("name = \"t\"\n", "", 1, "missing field `name`"),
        ("square-wave", "triangle-wave", 2, "unknown variant `triangle-wave`"),
        ("identify", "train", 3, "unknown variant `train`"),
        ("horizontal", "tilted", 4, "unknown variant `tilted`"),
        ("[start]", "colour = 3\n[start]", 5, "unknown field `colour`"),
        ("fixture = \"free\"\n", "", 5, "missing field `fixture`"),
        ("fixture = \"free\"", "fixture = \"driven\"", 6, "can't start with"),
        ("fixture = \"free\"", "fixture = \"clamped\"", 6, "`angle_deg` is missing"),
        ("bypass = \"closed\"", "bypass = \"closed\"\nfill_bar = 0", 9, "`fill_bar` must lie within"),
        ("bypass = \"closed\"", "bypass = \"closed\"\nfill_bar = \"$p\"", 9, "in scope: none"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good);
        let error = Script::parse(&text, "bad.toml").expect_err(to);
        assert_eq!(error.line, line, "{error}\n{text}");
        assert!(error.what.contains(reason), "{error}, expected: {reason}");
    }
}

#[test]
fn folders_are_loaded_or_refused_with_the_file() {
    let folder = std::env::temp_dir().join(format!("profiles-test-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    assert!(matches!(load_folder(&folder), Err(LoadError::Empty { .. })));
    assert!(matches!(load_folder(&folder.join("none")), Err(LoadError::Folder { .. })));
    assert!(matches!(Script::read(&folder), Err(LoadError::Read { .. })));
    let write = |file: &str, text: &str| std::fs::write(folder.join(file), text).expect("temporary file");
    let good = format!("{HEAD}[[step]]\nfor_s = 1\n");
    write("b.toml", &good);
    write("a.toml", &good.replacen("\"t\"", "\"u\"", 1));
    write("notes.txt", "no script");
    let names: Vec<_> = load_folder(&folder).expect("two scripts").into_iter().map(|s| s.name).collect();
    assert_eq!(names, ["u", "t"]);
    write("c.toml", &good);
    let error = load_folder(&folder).expect_err("a name twice").to_string();
    assert!(error.contains("c.toml") && error.contains("b.toml"), "{error}");
    write("c.toml", &good.replacen("for_s = 1", "for_s = 0", 1));
    let error = load_folder(&folder).expect_err("a bad script").to_string();
    assert!(error.contains("c.toml:10: "), "{error}");
    std::fs::remove_dir_all(&folder).expect("temporary folder");
}
