//! `vn100d completions` and `vn100d generate`: scripts for completions with the part of the program that answers them, and
//! manual pages made of the arguments.

use super::args::{Cli, CompletionsArgs, GenerateArgs};
use super::{Outcome, usage};
use anyhow::Context as _;
use clap::{Command, CommandFactory as _};
use clap_complete::env::Shells;
use clap_complete::{CompleteEnv, Shell};
use std::io::Write as _;
use std::path::Path;

/// The variable by which a shell's script asks for completions.
const ASKED: &str = "VN100D_COMPLETE";
/// The shells of the package, and the names under which they look for completions.
const SHELLS: [(Shell, &str); 3] =
    [(Shell::Bash, "vn100d.bash"), (Shell::Zsh, "_vn100d"), (Shell::Fish, "vn100d.fish")];

/// Returns the part of the program that answers a shell.
pub(super) fn environment() -> CompleteEnv<'static, fn() -> Command> {
    CompleteEnv::with_factory(Cli::command as fn() -> Command).var(ASKED)
}

/// Prints completions for a shell.
pub(super) fn completions(args: &CompletionsArgs) -> anyhow::Result<Outcome> {
    let mut text = Vec::new();
    script(args.shell, &mut text)?;
    std::io::stdout().write_all(&text)?;
    Ok(Outcome::Done)
}

/// Writes the script with which a shell asks the program for completions.
fn script(shell: Shell, text: &mut Vec<u8>) -> anyhow::Result<()> {
    let shells = Shells::builtins();
    let known = shells.completer(&shell.to_string()).context("there are no completions for this shell")?;
    known.write_registration(ASKED, "vn100d", "vn100d", "vn100d", text)?;
    if shell == Shell::Zsh {
        // Zsh loads a package's file at the first question, and expects an answer to it.
        let call = "if [ \"$funcstack[1]\" = _vn100d ]; then _clap_dynamic_completer_vn100d \"$@\"; fi\n";
        text.extend_from_slice(call.as_bytes());
    }
    Ok(())
}

/// Writes the manual pages, or all completions, into a folder.
pub(super) fn generate(args: &GenerateArgs) -> anyhow::Result<Outcome> {
    let folder = &args.dir;
    std::fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    match args.what.as_str() {
        "man" => manual(folder)?,
        "completions" => {
            for (shell, name) in SHELLS {
                let mut text = Vec::new();
                script(shell, &mut text)?;
                write(&folder.join(name), &text)?;
            }
        }
        other => {
            return Err(usage(format!("`{other}` cannot be generated: expected man or completions")));
        }
    }
    Ok(Outcome::Done)
}

/// Writes `vn100d.1`, and `vn100d-COMMAND.1` for each visible command.
fn manual(folder: &Path) -> anyhow::Result<()> {
    let mut command = Cli::command();
    command.build();
    page(folder, "vn100d", command.clone())?;
    for sub in command.get_subcommands().filter(|sub| !sub.is_hide_set() && sub.get_name() != "help") {
        let name = format!("vn100d-{}", sub.get_name());
        // Leaked: clap's names live as long as the program, which ends after this.
        let named = sub.clone().name(&*name.clone().leak()).bin_name(format!("vn100d {}", sub.get_name()));
        page(folder, &name, named)?;
    }
    Ok(())
}

fn page(folder: &Path, name: &str, command: Command) -> anyhow::Result<()> {
    let mut text = Vec::new();
    clap_mangen::Man::new(command).section("1").manual("vn100d").render(&mut text)?;
    write(&folder.join(format!("{name}.1")), &text)
}

fn write(path: &Path, text: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}
