//! `albireo completions`: prints the script with which a shell completes the program's arguments.

use clap::CommandFactory;
use clap_complete::Shell;

/// Arguments of `albireo completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  albireo completions bash > /usr/share/bash-completion/completions/albireo
  albireo completions zsh > ~/.zfunc/_albireo
  albireo completions fish > ~/.config/fish/completions/albireo.fish")]
pub(super) struct CompletionsArguments {
    /// The shell.
    shell: Shell,
}

pub(super) fn run(arguments: &CompletionsArguments) -> anyhow::Result<()> {
    let mut text = Vec::new();
    let mut command = super::Arguments::command();
    clap_complete::generate(arguments.shell, &mut command, "albireo", &mut text);
    print!("{}", String::from_utf8_lossy(&text));
    Ok(())
}
