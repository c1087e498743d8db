//! Definitions of messages that the user gives, for bags that lack them. Pure.
//!
//! In: a type's name (`Reading`, `own_msgs/Reading`, `own_msgs/msg/Reading`) and the text of its `.msg` file. A name
//! without a package stands for a type in any package. Out: a [`MessageDefinition`] of which every line is valid.

use super::field::{parse_field, plain_name};
use super::layout::Encoding;

/// The maximum size of a definition's text in bytes.
pub(in crate::recording) const TEXT_MAX: usize = 64 * 1024;
/// The maximum number of definitions.
const COUNT_MAX: usize = 100;

/// The definition of a message type that a recording lacks.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct MessageDefinition {
    name: String,
    text: String,
}

/// Why a definition is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DefinitionError {
    /// The name is no valid type name.
    #[error("message definition: {name:?} is no type's name, such as Reading or own_msgs/msg/Reading")]
    Name {
        /// The name.
        name: String,
    },
    /// A line is no valid field.
    #[error(
        "message definition of {name}: line {line} is no field of a .msg file ('float64 gyro_x_rad_s', say): {text:?}"
    )]
    Line {
        /// The type.
        name: String,
        /// The line's number.
        line: usize,
        /// The beginning of the line.
        text: String,
    },
    /// The text is too long to be a definition.
    #[error("message definition of {name}: {bytes} bytes are more than the {TEXT_MAX} that a .msg file may have")]
    Long {
        /// The type.
        name: String,
        /// Bytes of the text.
        bytes: usize,
    },
    /// A type is given twice.
    #[error("message definition: {name} is given twice")]
    Twice {
        /// The type.
        name: String,
    },
    /// There are too many definitions.
    #[error("{count} message definitions are more than {COUNT_MAX}")]
    Many {
        /// The number of definitions.
        count: usize,
    },
}

impl MessageDefinition {
    /// Returns the definition of the type `name`, from the text of its `.msg` file; further types may follow in it as
    /// in a bag's definitions.
    ///
    /// # Errors
    /// [`DefinitionError`] if the name or a line of the text is invalid.
    pub fn new(name: &str, text: &str) -> Result<Self, DefinitionError> {
        let name = name.trim();
        if !is_type_name(name) {
            return Err(DefinitionError::Name { name: name.chars().take(80).collect() });
        }
        let plain = plain_name(name);
        if text.len() > TEXT_MAX {
            return Err(DefinitionError::Long { name: plain, bytes: text.len() });
        }
        let mut kept = String::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let divides = line.starts_with("MSG:") || line.len() >= 3 && line.bytes().all(|byte| byte == b'=');
            if !divides && parse_field(line, Encoding::Cdr).is_err() {
                let text = line.chars().take(80).collect();
                return Err(DefinitionError::Line { name: plain, line: index + 1, text });
            }
            if !line.is_empty() {
                kept.push_str(line);
                kept.push('\n');
            }
        }
        Ok(Self { name: plain, text: kept })
    }

    /// Sorts the definitions; no two may have the same name.
    ///
    /// # Errors
    /// [`DefinitionError::Twice`] and [`DefinitionError::Many`].
    pub fn list(mut definitions: Vec<Self>) -> Result<Vec<Self>, DefinitionError> {
        if definitions.len() > COUNT_MAX {
            return Err(DefinitionError::Many { count: definitions.len() });
        }
        definitions.sort();
        match definitions.windows(2).find(|two| two[0].name == two[1].name) {
            Some(twice) => Err(DefinitionError::Twice { name: twice[0].name.clone() }),
            None => Ok(definitions),
        }
    }

    /// Returns the type: `package/Name`, or `Name` in any package.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the text of the type's `.msg` file without comments and empty lines, which have no effect.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the text of the type `package/Name` among these; a definition with its package takes precedence.
    pub(super) fn text_of<'a>(definitions: &'a [Self], name: &str) -> Option<&'a str> {
        let own = name.rsplit('/').next().unwrap_or_default();
        let find = |wanted: &str| definitions.iter().find(|definition| definition.name == wanted);
        find(name).or_else(|| find(own)).map(|definition| definition.text.as_str())
    }
}

/// Returns whether this is `Name`, `package/Name` or `package/msg/Name`.
pub fn is_type_name(name: &str) -> bool {
    let parts: Vec<&str> = name.split('/').collect();
    let is_word = |part: &&str| {
        part.starts_with(|first: char| first.is_ascii_alphabetic())
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    (parts.len() < 3 || parts.len() == 3 && parts[1] == "msg") && name.len() <= 200 && parts.iter().all(is_word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_texts_that_cannot_be_are_refused_with_the_line() {
        for (name, plain) in [("Reading", "Reading"), ("a/Reading", "a/Reading"), (" a_1/msg/Reading ", "a_1/Reading")]
        {
            assert_eq!(MessageDefinition::new(name, "float64 x").unwrap().name(), plain);
        }
        for name in ["", "a b", "a/b/c", "/a", "a//b", "1a", "a-b", &"a".repeat(201)] {
            assert!(matches!(MessageDefinition::new(name, ""), Err(DefinitionError::Name { .. })), "{name}");
        }
        let error = MessageDefinition::new("a/msg/Reading", "float64 x\n\n\u{FFFD}PNG\n").unwrap_err().to_string();
        assert!(error.contains("a/Reading") && error.contains("line 3") && error.contains("PNG"), "{error}");
        let long = "#".repeat(TEXT_MAX + 1);
        assert!(matches!(MessageDefinition::new("a", &long), Err(DefinitionError::Long { .. })));
        let text = "# what it is\nuint8 LIMIT=3\nstring<=10 name \"a b\"\nfloat64[<=3] y\n===\nMSG: other/Type\nint8 z";
        let definition = MessageDefinition::new("a", text).unwrap();
        assert!(definition.text().starts_with("uint8 LIMIT=3\nstring<=10 name"), "{}", definition.text());
        assert_eq!(MessageDefinition::new("a", definition.text()).unwrap(), definition, "comments change nothing");
    }

    #[test]
    fn each_type_is_given_once_and_the_one_with_its_package_counts() {
        let of = |name: &str, text: &str| MessageDefinition::new(name, text).unwrap();
        let list = MessageDefinition::list(vec![of("b/msg/T", "int8 x"), of("T", "int8 y")]).unwrap();
        assert_eq!(list[0].name(), "T", "in any order the same");
        assert_eq!(MessageDefinition::text_of(&list, "b/T"), Some("int8 x\n"));
        assert_eq!(MessageDefinition::text_of(&list, "c/T"), Some("int8 y\n"));
        assert_eq!(MessageDefinition::text_of(&list, "c/U"), None);
        let twice = MessageDefinition::list(vec![of("b/T", "int8 x"), of("b/msg/T", "int8 y")]).unwrap_err();
        assert_eq!(twice, DefinitionError::Twice { name: "b/T".to_owned() });
        let many = vec![of("T", ""); COUNT_MAX + 1];
        assert!(matches!(MessageDefinition::list(many), Err(DefinitionError::Many { .. })));
    }
}
