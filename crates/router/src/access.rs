//! Generates the router's access rules from the certificates.
//!
//! Zenoh's rules have no templates, so each node gets its own rules; whatever no rule allows is denied. A node may send
//! its status and counters, query under its own name, and declare its own token. A hub may read all nodes and answer
//! them. A router forwards everything. What the router sends to a session is limited by what that session may declare
//! and query, so the rules for that direction depend only on the role.

use crate::authority::{Entry, Role, subject};
use crate::error::{RouterError, other};
use albireo_wire::NodeKeys;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::Path;

/// Returns Zenoh's `access_control` section for the unrevoked certificates in `folder`, with keys under `prefix`. With
/// `pictures`, a hub may query nodes for camera pictures.
///
/// # Errors
/// [`RouterError`] if a certificate does not match the list, or if there is none.
pub fn access_control(
    folder: &Path,
    entries: &[Entry],
    prefix: &str,
    pictures: bool,
) -> Result<Value, RouterError> {
    let good: Vec<&Entry> = entries.iter().filter(|entry| entry.revoked_s.is_none()).collect();
    for entry in &good {
        let file = folder.join(entry.certificate());
        let found = subject(&file)?;
        let expected = entry.common_name();
        if found != expected {
            return other(format!(
                "{} is a certificate of `{found}`, but must be one of `{expected}`",
                file.display()
            ));
        }
    }
    rules(&good, prefix, pictures)
}

/// All that Zenoh's rules know of messages.
const EVERYTHING: [&str; 9] = [
    "put",
    "delete",
    "query",
    "reply",
    "declare_subscriber",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// What a part that answers queries declares and sends.
const ANSWERS: [&str; 2] = ["declare_queryable", "reply"];

/// The rules made so far, for keys under one prefix.
struct Rules<'a> {
    prefix: &'a str,
    /// The keys of all nodes.
    all: NodeKeys,
    /// True if a hub may query nodes for camera pictures.
    pictures: bool,
    made: Vec<Value>,
}

impl Rules<'_> {
    /// Makes a rule, and returns its id.
    fn allow(&mut self, id: &str, flow: &str, messages: &[&str], keys: &[String]) -> String {
        self.made.push(json!({
            "id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys,
        }));
        id.to_owned()
    }

    /// The keys that nodes query.
    fn queried(&self) -> [String; 2] {
        [self.all.report(), self.all.pull()]
    }

    /// The keys on which nodes publish.
    fn published(&self) -> [String; 2] {
        [self.all.status(), self.all.all_counters()]
    }

    /// The keys of camera pictures.
    fn picture(&self) -> [String; 1] {
        [self.all.all_pictures()]
    }

    /// What every node may receive.
    fn for_nodes(&mut self) -> Vec<String> {
        let queried = self.queried();
        let published = self.published();
        let changed = [self.all.changed()];
        let mut ids = vec![
            self.allow("to nodes", "egress", &["put"], &changed),
            self.allow("answers to nodes", "egress", &["reply"], &queried),
            // Nodes see only the hub's declarations, which show whether anybody receives their messages.
            self.allow(
                "declarations to nodes",
                "egress",
                &["declare_subscriber", "declare_queryable"],
                &[queried, published].concat(),
            ),
        ];
        if self.pictures {
            let picture = self.picture();
            ids.push(self.allow("picture queries", "egress", &["query"], &picture));
        }
        ids
    }

    /// What a hub may send and receive.
    fn for_hubs(&mut self) -> Vec<String> {
        let queried = self.queried();
        let published = self.published();
        let changed = [self.all.changed()];
        let alive = [self.all.alive()];
        let mut ids = vec![
            self.allow("hub notices", "ingress", &["put"], &changed),
            self.allow("hub answers", "ingress", &ANSWERS, &queried),
            self.allow("hub hears", "ingress", &["declare_subscriber"], &published),
            self.allow(
                "hub watches",
                "ingress",
                &["declare_liveliness_subscriber", "liveliness_query"],
                &alive,
            ),
            self.allow("to hubs", "egress", &["put"], &published),
            self.allow("questions to hubs", "egress", &["query"], &queried),
            self.allow(
                "declarations to hubs",
                "egress",
                &["declare_subscriber", "liveliness_token"],
                &[changed, alive].concat(),
            ),
        ];
        if self.pictures {
            let picture = self.picture();
            ids.push(self.allow("hub asks for pictures", "ingress", &["query"], &picture));
            ids.push(self.allow("pictures to hubs", "egress", &ANSWERS, &picture));
        }
        ids
    }

    /// What a router may forward.
    fn for_routers(&mut self) -> Vec<String> {
        // `**` does not match a part that begins with `@`.
        let every = [
            self.all.report(),
            self.all.pull(),
            self.all.status(),
            self.all.changed(),
            self.all.alive(),
            format!("{}/**", self.prefix),
        ];
        vec![
            self.allow("from routers", "ingress", &EVERYTHING, &every),
            self.allow("to routers", "egress", &EVERYTHING, &every),
        ]
    }

    /// What one node may send, under its own name alone.
    fn for_node(&mut self, name: &str) -> Result<Vec<String>, RouterError> {
        let keys = NodeKeys::new(self.prefix, name)?;
        let pictures = self.pictures;
        let mut may = |what: &str, messages: &[&str], keys: &[String]| {
            self.allow(&format!("{name} {what}"), "ingress", messages, keys)
        };
        let mut ids = vec![
            may("publishes", &["put"], &[keys.status(), keys.all_counters()]),
            may("asks", &["query"], &[keys.report(), keys.pull()]),
            may("hears", &["declare_subscriber"], &[keys.changed()]),
            may("lives", &["liveliness_token"], &[keys.alive()]),
        ];
        if pictures {
            ids.push(may("shows pictures", &ANSWERS, &[keys.all_pictures()]));
        }
        Ok(ids)
    }
}

fn rules(good: &[&Entry], prefix: &str, pictures: bool) -> Result<Value, RouterError> {
    let mut rules = Rules {
        prefix,
        all: NodeKeys::all(prefix)?,
        pictures,
        made: Vec::new(),
    };
    let for_nodes = rules.for_nodes();
    let for_hubs = rules.for_hubs();
    let for_routers = rules.for_routers();
    let mut subjects = Vec::new();
    let mut policies = Vec::new();
    let mut named = HashSet::new();
    for entry in good {
        let subject = entry.common_name();
        let own = match entry.role {
            Role::Hub => for_hubs.clone(),
            Role::Router => for_routers.clone(),
            Role::Node => {
                let mut own = rules.for_node(&entry.name)?;
                own.extend_from_slice(&for_nodes);
                own
            }
        };
        subjects.push(json!({ "id": subject, "cert_common_names": [subject] }));
        policies.push(json!({ "rules": own, "subjects": [subject] }));
        named.extend(own);
    }
    if subjects.is_empty() {
        return other("there is no valid certificate: nobody would have access");
    }
    // Zenoh warns about rules that no policy names.
    rules.made.retain(|rule| match rule["id"].as_str() {
        Some(id) => named.contains(id),
        None => false,
    });
    Ok(json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules.made,
        "subjects": subjects,
        "policies": policies,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenoh::key_expr::KeyExpr;

    fn entry(role: Role, name: &str, issue: u32, revoked_s: Option<i64>) -> Entry {
        Entry {
            role,
            name: name.to_owned(),
            issue,
            hosts: Vec::new(),
            ends_s: 0,
            revoked_s,
        }
    }

    /// The rules for the certificate `subject`, one a line: flow, messages, keys.
    fn rules_of(access: &Value, subject: &str) -> String {
        let policies = access["policies"].as_array().unwrap();
        let of_subject = |policy: &&Value| policy["subjects"][0] == subject;
        let policy = policies.iter().find(of_subject).unwrap();
        let ids = policy["rules"].as_array().unwrap();
        let mut lines = String::new();
        for rule in access["rules"].as_array().unwrap() {
            if ids.contains(&rule["id"]) {
                let flow = rule["flows"][0].as_str().unwrap();
                let messages = rule["messages"].to_string();
                let keys = rule["key_exprs"].to_string();
                lines.push_str(&format!("{flow} {messages} {keys}\n").replace('"', ""));
            }
        }
        lines
    }

    const OF_A_NODE: &str = "\
egress [put] [fleet/@changed/*]
egress [reply] [fleet/@report/*,fleet/@pull/*]
egress [declare_subscriber,declare_queryable] [fleet/@report/*,fleet/@pull/*,fleet/@status/*,fleet/*/*/counters]
ingress [put] [fleet/@status/car-7,fleet/car-7/*/counters]
ingress [query] [fleet/@report/car-7,fleet/@pull/car-7]
ingress [declare_subscriber] [fleet/@changed/car-7]
ingress [liveliness_token] [fleet/@alive/car-7]
";
    const OF_A_NODE_WITH_PICTURES: &str = "\
egress [put] [fleet/@changed/*]
egress [reply] [fleet/@report/*,fleet/@pull/*]
egress [declare_subscriber,declare_queryable] [fleet/@report/*,fleet/@pull/*,fleet/@status/*,fleet/*/*/counters]
egress [query] [fleet/*/*/picture]
ingress [put] [fleet/@status/car-7,fleet/car-7/*/counters]
ingress [query] [fleet/@report/car-7,fleet/@pull/car-7]
ingress [declare_subscriber] [fleet/@changed/car-7]
ingress [liveliness_token] [fleet/@alive/car-7]
ingress [declare_queryable,reply] [fleet/car-7/*/picture]
";

    #[test]
    fn a_node_may_do_only_what_its_role_needs() {
        let entries = [
            entry(Role::Node, "car-7", 2, None),
            entry(Role::Hub, "hub", 1, None),
        ];
        let all: Vec<_> = entries.iter().collect();
        for (pictures, expected) in [(false, OF_A_NODE), (true, OF_A_NODE_WITH_PICTURES)] {
            let access = rules(&all, "fleet", pictures).unwrap();
            assert_eq!(access["default_permission"], "deny");
            assert_eq!(rules_of(&access, "node/car-7/2"), expected);
        }
    }

    #[test]
    fn no_rule_is_made_that_no_certificate_needs() {
        let node = entry(Role::Node, "car-7", 2, None);
        let pictures = false;
        let access = rules(&[&node], "fleet/north", pictures).unwrap();
        let text = access["rules"].to_string();
        assert!(text.contains("fleet/north/car-7/*/counters"), "{text}");
        for nobodys in ["router", "hub", "picture"] {
            assert!(!text.contains(nobodys), "{nobodys}: {text}");
        }
    }

    proptest! {
        #[test]
        fn no_accepted_name_lets_a_node_send_on_the_node_keys_of_another(
            prefix in prop_oneof!["[a-z]{1,3}(/[a-z]{1,3})?", "[a-z/@*$ ]{1,4}"],
            names in proptest::collection::vec(prop_oneof![4 => "[a-z0-9-]{1,3}", 1 => "[a-z/@*$#?. -]{1,3}"], 2..5),
        ) {
            let entries: Vec<_> = names.iter().map(|name| entry(Role::Node, name, 1, None)).collect();
            let all: Vec<_> = entries.iter().collect();
            let pictures = true;
            let Ok(access) = rules(&all, &prefix, pictures) else { return Ok(()) };
            let taken = zenoh::Config::default().insert_json5("access_control", &access.to_string());
            prop_assert!(taken.is_ok(), "{taken:?}");
            let rules = access["rules"].as_array().unwrap();
            for policy in access["policies"].as_array().unwrap() {
                let subject = policy["subjects"][0].as_str().unwrap();
                for other in entries.iter().filter(|other| other.common_name() != subject) {
                    let keys = NodeKeys::new(&prefix, &other.name).unwrap();
                    let others_keys = [keys.status(), keys.report(), keys.pull(), keys.changed(), keys.alive()]
                        .map(|key| KeyExpr::new(key).unwrap());
                    let sent = rules.iter().filter(|rule| {
                        rule["flows"][0] == "ingress" && policy["rules"].as_array().unwrap().contains(&rule["id"])
                    });
                    for key in sent.flat_map(|rule| rule["key_exprs"].as_array().unwrap()) {
                        let key = KeyExpr::new(key.as_str().unwrap()).unwrap();
                        prop_assert!(!others_keys.iter().any(|its| key.intersects(its)), "{subject} may send {key}, which is of {}", other.name);
                    }
                }
            }
        }
    }

    #[test]
    fn a_list_of_only_revoked_certificates_is_an_error() {
        let folder = Path::new("/nowhere");
        let revoked = [entry(Role::Node, "car-7", 1, Some(1))];
        let pictures = false;
        let refused = access_control(folder, &revoked, "albireo", pictures).unwrap_err();
        let reason = refused.to_string();
        assert!(reason.contains("no valid certificate"), "{reason}");
    }
}
