//! `albireo cert`: manages the certificates of a fleet.

use super::terminal::program;
use albireo_router::authority::{Authority, DAY, Issued, Role};
use albireo_service::clock::unix_milliseconds;
use anyhow::bail;
use clap::Subcommand;
use std::path::{Path, PathBuf};

/// Arguments of `albireo cert`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The folder holds the authority's private key. Anyone who can read it can admit
any node, so keep it on a separate machine, and give each member only
authority.pem, its own certificate and its own key.

Examples:
  albireo cert authority --name 'fleet north'
  albireo cert router router-1 --host hub.example --host 203.0.113.7
  albireo cert hub hub-1
  albireo cert node car-7 car-8 car-9
  albireo cert list
  albireo cert renew --within 30                  all that expire within 30 days
  albireo cert revoke node car-7 && albireo acl --output access.json")]
pub(super) struct CertArguments {
    #[command(flatten)]
    place: AuthorityPlace,
    #[command(subcommand)]
    command: CertCommand,
}

/// Where a fleet's authority is.
#[derive(Debug, clap::Args)]
pub(super) struct AuthorityPlace {
    /// The authority's folder.
    #[arg(
        long,
        global = true,
        env = "ALBIREO_AUTHORITY",
        value_name = "FOLDER",
        default_value = "authority"
    )]
    pub(super) folder: PathBuf,
}

impl AuthorityPlace {
    pub(super) fn open(&self) -> anyhow::Result<Authority> {
        Ok(Authority::open(&self.folder)?)
    }
}

#[derive(Debug, Subcommand)]
enum CertCommand {
    /// Make the authority, once.
    Authority {
        /// The authority's name in its certificate.
        #[arg(long, default_value = "albireo fleet")]
        name: String,
        /// How long it is valid, days.
        #[arg(long, default_value_t = 3650, value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: u32,
    },
    /// Make certificates of nodes: each may report under its own name.
    Node(Members),
    /// Make certificates of hubs: they receive from all nodes and change their settings.
    Hub(Members),
    /// Make certificates of routers, for the names and addresses they are reached at.
    Router(Members),
    /// Renew certificates that are not revoked, also expired ones. The old ones stay valid until they expire.
    Renew {
        /// Role of the certificate to renew; needs the name.
        #[arg(requires = "name", required_unless_present = "within")]
        role: Option<Role>,
        /// Name in the certificate.
        name: Option<String>,
        /// Renew all certificates that expire within this many days, or have expired.
        #[arg(long, value_name = "DAYS", conflicts_with = "role")]
        within: Option<u32>,
        /// How long they are valid, days.
        #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: u32,
    },
    /// Leave a certificate out of all access rules that are generated from now on.
    Revoke {
        /// Role of the certificate.
        role: Role,
        /// Name in the certificate.
        name: String,
    },
    /// List all certificates, and when they expire.
    List {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

/// The services that get certificates.
#[derive(Debug, clap::Args)]
struct Members {
    /// Names of the services: a node's is the one in its configuration.
    #[arg(required = true)]
    names: Vec<String>,
    /// Name or address at which it is reached.
    #[arg(long = "host", value_name = "HOST")]
    hosts: Vec<String>,
    /// How long they are valid, days.
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=36_500))]
    days: u32,
}

pub(super) fn run(arguments: &CertArguments) -> anyhow::Result<()> {
    let place = &arguments.place;
    match &arguments.command {
        CertCommand::Authority { name, days } => {
            Authority::create(&place.folder, name, DAY * *days)?;
            println!("the authority `{name}` is in {}", place.folder.display());
        }
        CertCommand::Node(members) => issue(&mut place.open()?, Role::Node, members)?,
        CertCommand::Hub(members) => issue(&mut place.open()?, Role::Hub, members)?,
        CertCommand::Router(members) => {
            if members.hosts.is_empty() {
                bail!("--host is missing: nodes check that the router's certificate names it");
            }
            issue(&mut place.open()?, Role::Router, members)?;
        }
        CertCommand::Renew {
            role,
            name,
            within,
            days,
        } => {
            let mut authority = place.open()?;
            let mut members = Vec::new();
            if let (Some(role), Some(name)) = (role, name) {
                members.push((*role, name.clone()));
            }
            if let Some(within) = within {
                members.extend(expiring(&authority, *within));
            }
            if members.is_empty() {
                println!("no certificate expires that soon");
            }
            for (role, name) in members {
                print_issued(&authority.renew(role, &name, DAY * *days)?);
            }
        }
        CertCommand::Revoke { role, name } => {
            let revoked = place.open()?.revoke(*role, name)?;
            println!("{}", after_revoking(&revoked.common_name(), &place.folder));
        }
        CertCommand::List { json } => {
            let authority = place.open()?;
            if *json {
                println!("{}", serde_json::to_string_pretty(authority.entries())?);
            } else {
                list(&authority);
            }
        }
    }
    Ok(())
}

/// What remains to be done after `common_name` was revoked. Rules that are made with other options than before lock out
/// more than this one: the authority knows neither the prefix nor whether hubs may have pictures.
fn after_revoking(common_name: &str, folder: &Path) -> String {
    format!(
        "`{common_name}` is revoked once the router has new rules: run, with the --prefix and\n\
         --pictures that its present rules were made with,\n\
         `{} acl --folder {} --output access.json`,\n\
         copy access.json to /etc/albireo on the router's machine, and run there\n\
         `sudo systemctl restart albireo-router`",
        program(),
        folder.display()
    )
}

/// Returns role and name of each certificate that is not revoked and ends within so many days, or has ended already.
fn expiring(authority: &Authority, days: u32) -> Vec<(Role, String)> {
    let until_s = unix_milliseconds() / 1000 + i64::from(days) * 86_400;
    let mut expiring = Vec::new();
    for entry in authority.entries() {
        if entry.revoked_s.is_none() && entry.ends_s <= until_s {
            expiring.push((entry.role, entry.name.clone()));
        }
    }
    expiring
}

fn issue(authority: &mut Authority, role: Role, members: &Members) -> anyhow::Result<()> {
    for name in &members.names {
        let lasts = DAY * members.days;
        print_issued(&authority.issue(role, name, &members.hosts, lasts)?);
    }
    Ok(())
}

fn print_issued(issued: &Issued) {
    println!(
        "{}: {} and {}",
        issued.entry.common_name(),
        issued.certificate.display(),
        issued.key.display()
    );
}

fn list(authority: &Authority) {
    let now_s = unix_milliseconds() / 1000;
    for entry in authority.entries() {
        let left_s = entry.ends_s - now_s;
        let state = if entry.revoked_s.is_some() {
            "revoked".to_owned()
        } else if left_s < 0 {
            "has ended".to_owned()
        } else {
            format!("ends in {} days", left_s / 86_400)
        };
        println!("{:<40} {state}", entry.common_name());
    }
}

#[cfg(test)]
mod tests {
    use super::super::acl::AclArguments;
    use super::*;
    use clap::Args;

    #[test]
    fn every_option_that_rules_are_made_with_is_named_after_a_revocation() {
        let said = after_revoking("node/car-7/1", Path::new("fleet-north"));
        let acl = AclArguments::augment_args(clap::Command::new("acl"));
        assert!(acl.get_arguments().count() > 2);
        for argument in acl.get_arguments() {
            let option = format!("--{}", argument.get_long().unwrap());
            assert!(said.contains(&option), "{option}: {said}");
        }
    }
}
