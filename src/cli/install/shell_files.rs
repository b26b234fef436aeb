//! Manual pages and completions of shells, made from the declaration of the command line.

use clap::{Command, CommandFactory};
use clap_complete::{Shell, generate};
use clap_mangen::Man;

use crate::cli::Arguments;

/// A file: its path below the root, and its content.
type File = (String, Vec<u8>);

/// Where each shell looks for the completions of installed programs. `vendor-completions` is Debian's folder for zsh.
const COMPLETIONS: [(Shell, &str); 3] = [
    (Shell::Bash, "usr/share/bash-completion/completions/realitysim"),
    (Shell::Zsh, "usr/share/zsh/vendor-completions/_realitysim"),
    (Shell::Fish, "usr/share/fish/vendor_completions.d/realitysim.fish"),
];

/// Returns the manual page of the program and of each of its commands, and the completions of bash, zsh and fish.
pub(super) fn shell_files() -> std::io::Result<Vec<File>> {
    let mut program = Arguments::command().disable_help_subcommand(true);
    let mut files: Vec<File> = COMPLETIONS.map(|(shell, path)| (path.to_owned(), completions(shell, &program))).into();
    program.build();
    add_pages(&program, &mut files)?;
    Ok(files)
}

fn completions(shell: Shell, program: &Command) -> Vec<u8> {
    let mut script = Vec::new();
    generate(shell, &mut program.clone(), "realitysim", &mut script);
    script
}

/// Adds the page of a command, then those of the commands in it.
fn add_pages(command: &Command, files: &mut Vec<File>) -> std::io::Result<()> {
    let page =
        Man::new(command.clone()).source(concat!("realitysim ", env!("CARGO_PKG_VERSION"))).manual("Reality Sim");
    let mut content = Vec::new();
    page.render(&mut content)?;
    files.push((format!("usr/share/man/man1/{}", page.get_filename()), content));
    command.get_subcommands().try_for_each(|inner| add_pages(inner, files))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text_of(files: &[File], path: &str) -> String {
        let (_, content) = files.iter().find(|(known, _)| known == path).unwrap_or_else(|| panic!("{path}"));
        String::from_utf8(content.clone()).expect("text")
    }

    #[test]
    fn each_command_has_a_manual_page_and_a_place_in_each_completion() {
        let files = shell_files().expect("memory");
        let mut program = Arguments::command().disable_help_subcommand(true);
        program.build();
        for command in program.get_subcommands() {
            let page = text_of(&files, &format!("usr/share/man/man1/realitysim-{}.1", command.get_name()));
            assert!(page.contains(".SH SYNOPSIS") && page.contains("Example"), "{}", command.get_name());
            for (_, path) in COMPLETIONS {
                assert!(text_of(&files, path).contains(command.get_name()), "{path}: {}", command.get_name());
            }
        }
        let nested = text_of(&files, "usr/share/man/man1/realitysim-recorder-status.1");
        assert!(nested.contains("recorder status") || nested.contains("recorder\\-status"), "{nested}");
        let paths: std::collections::BTreeSet<&String> = files.iter().map(|(path, _)| path).collect();
        assert_eq!(paths.len(), files.len(), "no file is written over another");
    }
}
