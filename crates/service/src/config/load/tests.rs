use super::*;

#[derive(serde::Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Small {
    http: SmallHttp,
    camera: Vec<SmallCamera>,
}

#[derive(serde::Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct SmallHttp {
    timeout: f64,
    port: u16,
}

#[derive(serde::Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct SmallCamera {
    name: String,
    ring: usize,
}

impl Configuration for Small {
    const SECTIONS: &'static [&'static str] = &["HTTP"];

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        if self.http.port == 0 {
            findings.push(Finding::new("http.port", "must not be 0"));
        }
        for (index, camera) in self.camera.iter().enumerate() {
            if matches!(&*camera.name, "" | "a b") {
                let key = format!("camera[{index}].name");
                findings.push(Finding::new(key, "no such name"));
            }
        }
        findings
    }
}

#[derive(serde::Deserialize, Default)]
#[serde(default)]
struct Secretive {
    token: Vec<SecretiveToken>,
}

#[derive(serde::Deserialize, Default)]
#[serde(default)]
struct SecretiveToken {
    token: String,
}

impl Configuration for Secretive {
    const SECTIONS: &'static [&'static str] = &[];

    fn findings(&self) -> Vec<Finding> {
        self.token
            .iter()
            .filter(|token| token.token.is_empty())
            .map(|_| Finding::new("token", "is empty"))
            .collect()
    }
}

#[test]
fn all_errors_in_a_file_are_reported_at_once_in_plain_words() {
    let text = "[http]\ntimeout = \"long\"\nloud = 1\nprot = 8080\n[[camera]]\nring = \"two\"\n\
                [[camera]]\nname = \"a b\"\nrung = 3\n";
    let (_, findings) = examine_text::<Small>(text);
    let mut reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
    reported.sort();
    let expected = [
        "camera.a b.name: no such name",
        "camera.a b.rung: unknown key `rung`; did you mean `ring`?",
        "camera[0].name: no such name",
        "camera[0].ring: must be a whole number, 0 or more, not string \"two\"",
        "http.loud: unknown key `loud`; known are `timeout` or `port`",
        "http.prot: unknown key `prot`; did you mean `port`?",
        "http.timeout: must be a number, not string \"long\"",
    ];
    assert_eq!(reported, expected);
}

#[test]
fn a_typing_error_in_a_key_is_one_error() {
    for (text, error) in [
        (
            "[http]\nport = 1\n[[camera]]\nnmae = \"front\"\n",
            "camera[0].nmae: unknown key `nmae`; did you mean `name`?",
        ),
        (
            "[htp]\nport = 1\n",
            "htp: unknown key `htp`; did you mean `http`?",
        ),
        (
            "[http]\nprt = 2\nport = 1\n",
            "http.prt: unknown key `prt`; did you mean `port`?",
        ),
    ] {
        let (_, findings) = examine_text::<Small>(text);
        let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        assert_eq!(reported, [error], "{text}");
    }
}

#[test]
fn no_error_quotes_a_line_or_value_that_may_be_a_secret() {
    for (text, error) in [
        (
            "[http]\ntoken = [hidden\"\n",
            "TOML parse error at line 2, column 10: invalid array; expected `]`",
        ),
        (
            "token = \"hidden\"\n",
            "token: must be a sequence, not a string",
        ),
        (
            "[[token]]\ntoken = [\"hidden\"]\n",
            "token[0].token: must be a string, not a list",
        ),
    ] {
        let (_, findings) = examine_text::<Secretive>(text);
        let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        assert_eq!(reported, [error], "{text}");
    }
}

#[test]
fn a_file_that_ends_where_a_value_has_to_be_is_told_so() {
    for (text, column) in [("[http]\nport = ", 8), ("[http]\nport = {a = ", 13)] {
        let (_, findings) = examine_text::<Small>(text);
        let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        let error = format!(
            "TOML parse error at line 2, column {column}: a value is expected before the end of the file"
        );
        assert_eq!(reported, [error], "{text}");
    }
}

#[derive(serde::Deserialize, Debug, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Mode {
    Peer,
    Client,
}

#[derive(serde::Deserialize, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
struct Typed {
    node: TypedNode,
}

#[derive(serde::Deserialize, Debug, Default, PartialEq)]
#[serde(deny_unknown_fields, default)]
struct TypedNode {
    name: String,
    u: Option<f64>,
    port: u16,
    on: bool,
    mode: Option<Mode>,
    connect: Vec<String>,
    sizes: Vec<u32>,
    labels: std::collections::BTreeMap<String, String>,
    folder: Option<std::path::PathBuf>,
}

impl Configuration for Typed {
    const SECTIONS: &'static [&'static str] = &["NODE"];

    fn findings(&self) -> Vec<Finding> {
        Vec::new()
    }
}

/// What is read from a file with these variables, which have the names of keys under `[node]`, and what is wrong.
fn typed(text: &str, keys: &[(&str, &str)]) -> (TypedNode, Vec<String>) {
    let mut variables = Vec::new();
    for (key, value) in keys {
        let name = format!("{PREFIX}NODE__{}", key.to_ascii_uppercase());
        variables.push((name, (*value).to_owned()));
    }
    let home = Some(Path::new("/home/ann"));
    let (config, findings) = examine_with::<Typed>(text, &variables, home);
    let wrong = findings.iter().map(ToString::to_string).collect();
    (config.unwrap_or_default().node, wrong)
}

#[test]
fn a_variable_is_read_by_the_type_of_its_key() {
    let nothing = TypedNode::default;
    let named = |name: &str| TypedNode {
        name: name.to_owned(),
        ..nothing()
    };
    let connect = |list: &[&str]| TypedNode {
        connect: list.iter().map(|one| (*one).to_owned()).collect(),
        ..nothing()
    };
    let u = |u| TypedNode {
        u: Some(u),
        ..nothing()
    };
    let sizes = |sizes: &[u32]| TypedNode {
        sizes: sizes.to_vec(),
        ..nothing()
    };
    let port = TypedNode {
        port: 80,
        ..nothing()
    };
    let on = TypedNode {
        on: true,
        ..nothing()
    };
    let mode = TypedNode {
        mode: Some(Mode::Client),
        ..nothing()
    };
    for (key, text, read) in [
        ("name", "4711", named("4711")),
        ("name", "0042", named("0042")),
        ("name", "12.5", named("12.5")),
        ("name", "5e-4", named("5e-4")),
        ("name", "true", named("true")),
        ("name", "[a]", named("[a]")),
        ("name", "\"4711\"", named("4711")),
        ("name", "", named("")),
        ("u", "5e-4", u(5e-4)),
        ("u", "5E-4", u(5e-4)),
        ("u", "0.0005", u(5e-4)),
        ("u", " 3 ", u(3.0)),
        ("port", "80", port),
        ("on", "true", on),
        ("mode", "client", mode),
        ("connect", "tcp/a:1", connect(&["tcp/a:1"])),
        (
            "connect",
            "tcp/a:1, tcp/b:2",
            connect(&["tcp/a:1", "tcp/b:2"]),
        ),
        ("connect", "[\"tcp/a:1\"]", connect(&["tcp/a:1"])),
        ("connect", "4711,5e-4", connect(&["4711", "5e-4"])),
        ("connect", "", connect(&[])),
        ("sizes", "320", sizes(&[320])),
        ("sizes", "320,640", sizes(&[320, 640])),
        ("sizes", "[320, 640]", sizes(&[320, 640])),
    ] {
        assert_eq!(
            typed("", &[(key, text)]),
            (read, Vec::new()),
            "{key}={text}"
        );
    }
    let in_file = "[node.labels]\nline = \"south\"\ndepot = \"1\"\n";
    let variables = [("labels__region", "7"), ("labels__line", "north")];
    let (node, wrong) = typed(in_file, &variables);
    let expected = [("depot", "1"), ("line", "north"), ("region", "7")]
        .map(|(name, value)| (name.to_owned(), value.to_owned()));
    assert_eq!(node.labels, expected.into());
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn a_variable_of_another_type_is_reported_with_its_name() {
    let from = |key: &str| format!(" (from environment variable ALBIREO_NODE__{key})");
    for (key, text, error) in [
        ("u", "low", "node.u: must be a number, not string \"low\""),
        (
            "port",
            "-1",
            "node.port: must be a whole number, 0 or more, not signed int `-1`",
        ),
        (
            "mode",
            "4711",
            "node.mode: `4711` is not `peer` or `client`",
        ),
        (
            "sizes",
            "320,b",
            "node.sizes[1]: must be a whole number, 0 or more, not string \"b\"",
        ),
    ] {
        let (_, wrong) = typed("", &[(key, text)]);
        let reported = wrong.join("; ");
        assert!(reported.starts_with(error), "{reported}");
        assert!(reported.contains(&from(&key.to_uppercase())), "{reported}");
    }
}

#[test]
fn a_variable_with_a_typing_error_in_its_name_is_one_error() {
    for (name, text, error) in [
        (
            "ALBIREO_NDE__PORT",
            "80",
            "nde: unknown key `nde`; did you mean `node`? (from environment variable ALBIREO_NDE)",
        ),
        (
            "ALBIREO_NODE__V",
            "3e-4",
            "node.v: unknown key `v`; did you mean `u`? (from environment variable ALBIREO_NODE__V)",
        ),
    ] {
        let variables = [(name.to_owned(), text.to_owned())];
        let (_, findings) = examine_with::<Typed>("", &variables, None);
        let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        assert_eq!(reported, [error], "{name}");
    }
}

#[test]
fn a_key_beside_a_misspelt_one_is_read_and_its_own_error_reported() {
    let (_, findings) = examine_text::<Small>("[http]\nprt = 2\nport = \"low\"\n");
    let mut reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
    reported.sort();
    let expected = [
        "http.port: must be a whole number, 0 or more, not string \"low\"",
        "http.prt: unknown key `prt`; did you mean `port`?",
    ];
    assert_eq!(reported, expected);
}

#[test]
fn a_number_that_is_not_finite_does_not_pass_for_a_key_that_is_not_set() {
    for (text, key) in [
        ("u = inf", "node.u"),
        ("u = -inf", "node.u"),
        ("u = nan", "node.u"),
        ("port = inf", "node.port"),
        ("sizes = [1, nan]", "node.sizes[1]"),
    ] {
        let (_, wrong) = typed(&format!("[node]\n{text}\n"), &[]);
        let error = format!("{key}: must be a finite number, not inf or nan");
        assert_eq!(wrong, [error], "{text}");
    }
}

#[derive(serde::Deserialize, Debug, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Goal {
    Recall(f64),
}

#[derive(serde::Deserialize, Default)]
#[serde(default)]
struct Held {
    hold: Option<Goal>,
}

impl Configuration for Held {
    const SECTIONS: &'static [&'static str] = &[];

    fn findings(&self) -> Vec<Finding> {
        Vec::new()
    }
}

#[test]
fn a_wrong_choice_with_a_value_is_one_error_in_plain_words() {
    let (config, findings) = examine_text::<Held>("hold = { recall = 0.9 }\n");
    assert_eq!(config.unwrap().hold, Some(Goal::Recall(0.9)));
    assert!(findings.is_empty());
    for (text, error) in [
        (
            "hold = \"recall\"",
            "hold: must be a name with its value, { name = value }, not a name alone",
        ),
        ("hold = 3", "hold: must be a name, not unsigned int `3`"),
        (
            "hold = { recal = 0.9 }",
            "hold.recal: `recal` is not `recall`",
        ),
        (
            "hold = { recall = inf }",
            "hold.recall: must be a finite number, not inf or nan",
        ),
    ] {
        let (_, findings) = examine_text::<Held>(text);
        let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        assert_eq!(reported, [error], "{text}");
    }
}

#[test]
fn a_tilde_is_the_home_folder_in_a_file_and_in_a_variable() {
    let state = Some(Path::new("/home/ann/state"));
    let (node, _) = typed("[node]\nfolder = \"~/state\"\n", &[]);
    assert_eq!(node.folder.as_deref(), state);
    let (node, _) = typed("", &[("folder", "~/state"), ("connect", "~/a,~/b")]);
    assert_eq!(node.folder.as_deref(), state);
    assert_eq!(node.connect, ["/home/ann/a", "/home/ann/b"]);
}

#[test]
fn a_wrong_element_of_a_list_leaves_the_others_their_places() {
    let (config, findings) = examine_text::<Small>("camera = [{}, 7, { name = \"a b\" }]\n");
    let of_cameras: Vec<_> = findings
        .iter()
        .map(|finding| finding.key.as_str())
        .filter(|key| key.starts_with("camera"))
        .collect();
    assert_eq!(of_cameras, ["camera[1]"]);
    assert!(config.unwrap().camera.is_empty());
}
