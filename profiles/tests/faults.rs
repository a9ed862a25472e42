//! The faults of a script: what they are read as, and what is said about a bad one.

use profiles::Script;
use rt_core::fault::{Fault, FaultKind, Route, Valve, full_scale};
use rt_core::{Input, Measurement, Reference, Tick};

/// Line 12 is the first after it.
const HEAD: &str = r#"name = "t"
protocol = "square-wave"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[[step]]
voltage_v = 2.0
for_s = 1.0
"#;

fn parse(faults: &str) -> Vec<Fault> {
    Script::parse(&format!("{HEAD}{faults}"), "t.toml").unwrap_or_else(|error| panic!("{error}\n{faults}")).faults
}

#[test]
fn every_kind_is_read_with_its_numbers() {
    let (low, high) = full_scale(Input::Angle);
    let angle = Input::Angle;
    let cases: &[(&str, FaultKind)] = &[
        ("kind = \"lost\"\ninput = \"volume_ml\"", FaultKind::Lost { route: Route::Input(Input::Volume) }),
        ("kind = \"lost\"\noutput = \"voltage\"", FaultKind::Lost { route: Route::Voltage { timeout_ticks: 100 } }),
        (
            "kind = \"late\"\noutput = \"valves\"\ndelay_ms = 7\ntimeout_ms = 30",
            FaultKind::Late { route: Route::Valves { timeout_ticks: 30 }, ticks: 7, unnoticed: false },
        ),
        (
            "kind = \"late\"\ninput = \"torque_nm\"\ndelay_ms = 1000\nunnoticed = true",
            FaultKind::Late { route: Route::Input(Input::Torque), ticks: 1000, unnoticed: true },
        ),
        ("kind = \"repeated\"\ninput = \"angle_deg\"", FaultKind::Repeated { input: angle, unnoticed: false }),
        (
            "kind = \"swapped\"\ninput = \"pressure2_bar\"\nunnoticed = true",
            FaultKind::Swapped { input: Input::Pressure2, unnoticed: true },
        ),
        ("kind = \"bit-flip\"\ninput = \"angle_deg\"", FaultKind::BitFlip { input: angle, bit: None, low, high }),
        (
            "kind = \"bit-flip\"\ninput = \"angle_deg\"\nbit = 15\nrange = [-1, 2.5]",
            FaultKind::BitFlip { input: angle, bit: Some(15), low: -1.0, high: 2.5 },
        ),
        ("kind = \"crc-error\"\ninput = \"pressure1_bar\"", FaultKind::CrcError { input: Input::Pressure1 }),
        ("kind = \"stuck\"\ninput = \"angle_deg\"", FaultKind::Stuck { input: angle }),
        ("kind = \"drift\"\ninput = \"angle_deg\"\nrate_per_s = -0.5", FaultKind::Drift { input: angle, per_s: -0.5 }),
        ("kind = \"nan\"\ninput = \"angle_deg\"", FaultKind::Nan { input: angle }),
        ("kind = \"port-gone\"", FaultKind::PortGone { timeout_ticks: 100 }),
        ("kind = \"bus-off\"\ntimeout_ms = 20", FaultKind::BusOff { timeout_ticks: 20 }),
        ("kind = \"amplifier-fault\"\ncode = 4", FaultKind::AmplifierFault { code: 4 }),
        ("kind = \"valve-stuck\"\nvalve = \"brake\"", FaultKind::ValveStuck { valve: Valve::Brake, open: None }),
        (
            "kind = \"valve-stuck\"\nvalve = \"bypass\"\nstands = \"closed\"",
            FaultKind::ValveStuck { valve: Valve::Bypass, open: Some(false) },
        ),
    ];
    let all: String = cases.iter().map(|(keys, _)| format!("[[fault]]\nat_s = 0.25\nfor_s = 0.1\n{keys}\n")).collect();
    let read = parse(&all);
    assert_eq!(read.len(), cases.len());
    for (number, (fault, (keys, kind))) in read.iter().zip(cases).enumerate() {
        assert_eq!(*fault, Fault { kind: *kind, from_tick: 250, ticks: Some(100), probability: 1.0 }, "{keys}");
        assert_eq!(fault.check(number + 1), Ok(()), "what a script may say can be injected");
        assert!(keys.starts_with(&format!("kind = \"{}\"", fault.kind.name())), "{keys}: {}", fault.kind.name());
    }
}

#[test]
fn a_fault_may_last_to_the_end_and_hit_a_share() {
    let read = parse("[[fault]]\nkind = \"nan\"\nat_s = 0\ninput = \"angle_deg\"\nprobability = 0.01\n");
    let kind = FaultKind::Nan { input: Input::Angle };
    assert_eq!(read, [Fault { kind, from_tick: 0, ticks: None, probability: 0.01 }]);
    assert_eq!(parse(""), []);
}

#[test]
fn faults_stay_in_the_text_and_change_nothing_that_is_driven() {
    let folder = tempdir();
    std::fs::write(folder.join("a.csv"), "time_s,value\n0,0\n1,2\n").expect("a table");
    let steps = "[[step]]\ntarget = { quantity = \"voltage_v\", wave = \"file\", file = \"a.csv\" }\nfor_s = 1\n";
    let fault = "[[fault]]\nkind = \"stuck\"\nat_s = 0.1\ninput = \"angle_deg\"\n";
    std::fs::write(folder.join("s.toml"), format!("{HEAD}{steps}{fault}")).expect("a script");
    let script = Script::read(&folder.join("s.toml")).expect("reads");
    std::fs::remove_dir_all(&folder).expect("temporary folder");
    assert!(script.text.contains("[files]"));
    let again = Script::parse(&script.text, "recording").expect("its own text");
    assert_eq!((again.faults.len(), &again.faults), (1, &script.faults));

    let context = profiles::Context { u_max_v: 20.0, seed: 3, hands: profiles::Hands::Rig };
    let mut with = again.compile(&context).expect("compiles");
    let without = Script::parse(&script.text.replace(fault, ""), "t.toml").expect("parses");
    assert_eq!(without.faults, []);
    let mut without = without.compile(&context).expect("compiles");
    for tick in 0..2100 {
        let now = Tick::at(tick);
        assert_eq!(with.step(now, &Measurement::NONE), without.step(now, &Measurement::NONE));
    }
}

fn tempdir() -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!("profiles-faults-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    folder
}

/// Behind `[[fault]]` in line 12: the lines from 13 on, the line of the mistake, and a part of the message.
const BAD: &[(&str, usize, &str)] = &[
    ("at_s = 1", 12, "missing field `kind`"),
    ("kind = \"port-gone\"", 12, "missing field `at_s`"),
    ("kind = \"gremlin\"\nat_s = 1", 13, "unknown variant `gremlin`"),
    ("kind = \"port-gone\"\nat_s = 1\nwhere = 2", 15, "unknown field `where`"),
    ("kind = \"port-gone\"\nat_s = -1", 14, "`at_s` must lie within 0 .. 86400, got -1"),
    ("kind = \"port-gone\"\nat_s = nan", 14, "finite"),
    ("kind = \"port-gone\"\nat_s = \"$a\"", 14, "in scope: none"),
    ("kind = \"port-gone\"\nat_s = 1\nfor_s = 0", 15, "`for_s` must lie within"),
    ("kind = \"port-gone\"\nat_s = 1\ntimeout_ms = 0", 15, "`timeout_ms` must lie within 1 .. 10000, got 0"),
    ("kind = \"port-gone\"\nat_s = 1\ninput = \"angle_deg\"", 15, "the fault `port-gone` has no `input`"),
    ("kind = \"stuck\"\nat_s = 1", 13, "`input` is missing"),
    ("kind = \"stuck\"\nat_s = 1\ninput = \"angle\"", 15, "unknown variant `angle`"),
    ("kind = \"stuck\"\nat_s = 1\ninput = \"angle_deg\"\nprobability = 0.5", 16, "has no `probability`"),
    ("kind = \"nan\"\nat_s = 1\ninput = \"angle_deg\"\nprobability = 0", 16, "above 0"),
    ("kind = \"nan\"\nat_s = 1\ninput = \"angle_deg\"\nprobability = 1.5", 16, "0 .. 1, got 1.5"),
    ("kind = \"lost\"\nat_s = 1", 13, "either an `input` or an `output`, got neither"),
    ("kind = \"lost\"\nat_s = 1\ninput = \"angle_deg\"\noutput = \"valves\"", 13, "got both"),
    ("kind = \"lost\"\nat_s = 1\noutput = \"clamp\"", 15, "unknown variant `clamp`"),
    ("kind = \"lost\"\nat_s = 1\ninput = \"angle_deg\"\ntimeout_ms = 5", 16, "belongs to `output`"),
    ("kind = \"late\"\nat_s = 1\ninput = \"angle_deg\"", 13, "`delay_ms` is missing"),
    ("kind = \"late\"\nat_s = 1\ninput = \"angle_deg\"\ndelay_ms = 1001", 16, "1 .. 1000, got 1001"),
    ("kind = \"late\"\nat_s = 1\noutput = \"voltage\"\ndelay_ms = 5\nunnoticed = true", 17, "belongs to `input`"),
    ("kind = \"bit-flip\"\nat_s = 1\ninput = \"angle_deg\"\nbit = 16", 16, "0 .. 15, got 16"),
    ("kind = \"bit-flip\"\nat_s = 1\ninput = \"angle_deg\"\nbit = -1", 16, "-1"),
    ("kind = \"bit-flip\"\nat_s = 1\ninput = \"angle_deg\"\nrange = [2, 2]", 16, "got [2, 2]"),
    ("kind = \"drift\"\nat_s = 1\ninput = \"angle_deg\"", 13, "`rate_per_s` is missing"),
    ("kind = \"drift\"\nat_s = 1\ninput = \"angle_deg\"\nrate_per_s = 0", 16, "nothing would drift"),
    ("kind = \"amplifier-fault\"\nat_s = 1", 13, "`code` is missing"),
    ("kind = \"amplifier-fault\"\nat_s = 1\ncode = 70000", 15, "70000"),
    ("kind = \"valve-stuck\"\nat_s = 1", 13, "`valve` is missing"),
    ("kind = \"valve-stuck\"\nat_s = 1\nvalve = \"brake\"\nstands = \"ajar\"", 16, "ajar"),
];

#[test]
fn a_bad_fault_is_refused_with_file_line_and_reason() {
    for (keys, line, reason) in BAD {
        let text = format!("{HEAD}[[fault]]\n{keys}\n");
        let error = Script::parse(&text, "dir/bad.toml").expect_err(keys);
        assert_eq!(error.line, *line, "{error}\n{keys}");
        assert!(error.what.contains(reason), "{error}\nexpected: {reason}");
        assert!(error.to_string().starts_with(&format!("dir/bad.toml:{line}: ")), "{error}");
    }
    let many = format!("{HEAD}{}", "[[fault]]\nkind = \"port-gone\"\nat_s = 1\n".repeat(101));
    let error = Script::parse(&many, "t.toml").expect_err("101 faults");
    assert!(error.line == 12 + 3 * 100 && error.what.contains("at most 100 faults, got 101"), "{error}");
}
