//! The documentation's code blocks run unchanged.
//!
//! A block whose first line is ```` ```sh no-run: REASON ```` is not run and must give its reason. The README's two
//! commands are the tests themselves: `tests/it/demo.rs` runs the demonstration, and this is `cargo test`.

use std::path::{Path, PathBuf};
use std::process::Command;

const OF_THE_TESTS: [&str; 2] = ["cargo run --release -- demo", "cargo test"];

struct Block {
    file: String,
    line: usize,
    language: String,
    no_run: Option<String>,
    text: String,
}

fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = vec![root.join("README.md")];
    for folder in ["docs", "docs/reliability"] {
        for entry in std::fs::read_dir(root.join(folder)).unwrap().flatten() {
            if entry.path().extension().is_some_and(|extension| extension == "md") {
                pages.push(entry.path());
            }
        }
    }
    pages.sort();
    pages
}

fn blocks() -> Vec<Block> {
    let mut blocks = Vec::new();
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        let mut open: Option<Block> = None;
        for (number, line) in text.lines().enumerate() {
            match (&mut open, line.strip_prefix("```")) {
                (None, Some(info)) => {
                    let (language, rest) = info.split_once(' ').unwrap_or((info, ""));
                    open = Some(Block {
                        file: page.file_name().unwrap().to_string_lossy().into_owned(),
                        line: number + 1,
                        language: language.to_owned(),
                        no_run: rest
                            .strip_prefix("no-run")
                            .map(|reason| reason.trim_start_matches(':').trim().to_owned()),
                        text: String::new(),
                    });
                }
                (Some(block), None) => {
                    block.text.push_str(line);
                    block.text.push('\n');
                }
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (None, None) => {}
            }
        }
        assert!(open.is_none(), "{} has a block without an end", page.display());
    }
    blocks
}

#[test]
fn every_shell_block_runs_or_states_why_not() {
    let program = Path::new(env!("CARGO_BIN_EXE_vn100d"));
    let mut run = 0;
    // The blocks of a page follow each other, as a reader types them: one folder for all of them.
    let mut folders = std::collections::BTreeMap::new();
    for block in blocks().iter().filter(|block| block.language == "sh") {
        let place = format!("{}:{}", block.file, block.line);
        if let Some(reason) = &block.no_run {
            assert!(reason.len() > 5, "{place} is not run and does not state why");
            continue;
        }
        if OF_THE_TESTS.contains(&block.text.trim()) {
            continue;
        }
        let folder = folders.entry(&block.file).or_insert_with(|| tempfile::tempdir().unwrap());
        let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
        let output = Command::new("sh")
            .args(["-e", "-c", &block.text])
            .current_dir(folder.path())
            .env("PATH", path)
            .env("HOME", folder.path())
            .env_remove("VN100D_DATA_DIR")
            .env_remove("VN100D_CONFIG")
            .output()
            .unwrap();
        let printed = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{place} fails:\n{printed}");
        run += 1;
    }
    assert!(run > 0, "no block was run");
}

#[test]
fn the_readme_names_the_two_commands_and_every_page_it_links_to_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    for command in OF_THE_TESTS {
        assert!(readme.contains(&format!("```sh\n{command}\n```")), "{command}");
    }
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for target in text.split("](").skip(1).map(|rest| rest.split([')', '#']).next().unwrap()) {
            if !target.is_empty() && !target.contains("://") {
                assert!(page.parent().unwrap().join(target).exists(), "{} links to {target}", page.display());
            }
        }
    }
}
