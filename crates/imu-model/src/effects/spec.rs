//! The specification of an effect's entry in a model's file: names, ranges and meanings in one table per effect.
//!
//! In: the parameters as JSON. Out: checked values, or a [`Refusal`] with the parameter, the value found and the values
//! allowed. Messages, the JSON Schema, a report's phrases and the documentation's tables are made from the same
//! entries.

use super::{EffectKind, Stage};
use serde_json::{Map, Value, json};
use std::sync::Arc;

/// Why a parameter was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{effect}: `{parameter}`: found {found}; allowed is {allowed}")]
pub struct Refusal {
    /// The effect.
    pub effect: EffectKind,
    /// The parameter, with the place inside it: `intervals[2]`.
    pub parameter: String,
    /// The value that was found.
    pub found: String,
    /// The values that are allowed.
    pub allowed: String,
}

/// The largest parameter, in its unit: results computed from larger ones soon overflow. Measured values are far smaller.
pub const LARGEST: f64 = 1e30;

/// A range of numbers. The numbers are finite in any case, and none is larger than [`LARGEST`] or smaller than its negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// Any number.
    Any,
    /// 0 or more.
    FromZero,
    /// Above the number.
    Above(f64),
    /// From 0 to below 1.
    Probability,
    /// The number or more.
    From(f64),
    /// Above the first number and below the second.
    Between(f64, f64),
}

impl Range {
    fn contains(self, number: f64) -> bool {
        number.abs() <= LARGEST
            && match self {
                Self::Any => true,
                Self::FromZero => number >= 0.0,
                Self::Above(least) => number > least,
                Self::Probability => (0.0..1.0).contains(&number),
                Self::From(least) => number >= least,
                Self::Between(low, high) => low < number && number < high,
            }
    }
    /// Returns a description for a caller that gave this number. It states the limit of all ranges if the number
    /// exceeds that.
    fn words_for(self, number: Option<f64>) -> String {
        match number.filter(|number| number.abs() > LARGEST) {
            Some(_) => format!("{} of {LARGEST:e} at most in size", self.words()),
            None => self.words(),
        }
    }
    /// Returns a description such as "a number above 0".
    pub fn words(self) -> String {
        match self {
            Self::Any => "a finite number".to_owned(),
            Self::FromZero => "a number of 0 or more".to_owned(),
            Self::Above(least) => format!("a number above {least}"),
            Self::Probability => "a probability from 0 to below 1".to_owned(),
            Self::From(least) => format!("a number of {least} or more"),
            Self::Between(low, high) => format!("a number above {low} and below {high}"),
        }
    }
    fn schema(self) -> Value {
        match self {
            Self::Any => json!({"type": "number", "minimum": -LARGEST, "maximum": LARGEST}),
            Self::FromZero => json!({"type": "number", "minimum": 0, "maximum": LARGEST}),
            Self::Above(least) => json!({"type": "number", "exclusiveMinimum": least, "maximum": LARGEST}),
            Self::Probability => json!({"type": "number", "minimum": 0, "exclusiveMaximum": 1}),
            Self::From(least) => json!({"type": "number", "minimum": least, "maximum": LARGEST}),
            Self::Between(low, high) => json!({"type": "number", "exclusiveMinimum": low, "exclusiveMaximum": high}),
        }
    }
}

/// The form of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// One number.
    Number(Range),
    /// An instant, s from the record's begin: 0 or more.
    Time,
    /// A whole number between the two, inclusive.
    Whole(u64, u64),
    /// One or more numbers.
    Numbers(Range),
    /// One or more pairs [from, to] in s, from 0 on, each ending after it begins.
    Intervals,
    /// Two or more pairs [time in s, factor of 0 or more], with increasing times.
    Profile,
    /// Two or more pairs [frequency in Hz, density of 0 or more], with frequencies increasing from 0 or above.
    Density,
    /// One of these effects: an object as in a list of effects.
    Effect(&'static [&'static Spec]),
    /// Three rows of three numbers.
    Matrix,
    /// One of these words.
    Choice(&'static [&'static str]),
}

/// Whether a parameter has to be given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Need {
    /// The parameter is required.
    Always,
    /// The parameter may be absent; this is the default.
    Default(f64),
    /// The parameter may be absent; this is the default, which a model does not write.
    Unwritten(f64),
    /// The parameter may be absent; without it the effect omits the feature.
    Optional,
    /// The parameter is required in the form to which it belongs, if that form is chosen ([`Spec::forms`]).
    InItsForm,
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// The key of the parameter.
    pub name: &'static str,
    /// The allowed values.
    pub form: Form,
    /// Whether the parameter has to be given.
    pub need: Need,
    /// The unit (U: the channel's unit); empty for a number without a unit.
    pub unit: &'static str,
    /// The meaning of the parameter.
    pub meaning: &'static str,
}

/// Any number.
pub(super) const ANY: Form = Form::Number(Range::Any);
/// A number of 0 or more.
pub(super) const FROM_ZERO: Form = Form::Number(Range::FromZero);
/// A probability below 1.
pub(super) const PROBABILITY: Form = Form::Number(Range::Probability);
/// Returns the form of a number above this one.
pub(super) const fn above(least: f64) -> Form {
    Form::Number(Range::Above(least))
}

impl Parameter {
    /// Creates a required parameter.
    pub(super) const fn new(name: &'static str, form: Form, unit: &'static str, meaning: &'static str) -> Self {
        Self { name, form, need: Need::Always, unit, meaning }
    }

    pub(super) const fn needed(self, need: Need) -> Self {
        Self { need, ..self }
    }

    /// Returns the value of a parameter that is not given.
    pub fn default(&self) -> Option<f64> {
        match self.need {
            Need::Default(value) | Need::Unwritten(value) => Some(value),
            _ => None,
        }
    }

    /// Returns whether a model writes the value.
    pub(super) fn writes(&self, value: &Value) -> bool {
        match self.need {
            Need::Unwritten(default) => value.as_f64() != Some(default),
            Need::Optional => value.as_array().is_none_or(|list| !list.is_empty()),
            _ => true,
        }
    }
}

/// How an effect shows in a record at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Nature {
    /// A density throughout the record that is white at low frequencies: a part of N, or a filter of it.
    White,
    /// A density throughout the record with a slope or a correlation time.
    Coloured,
    /// The distribution of single samples.
    Samples,
    /// Any other: a course, a line, a density that changes with time.
    Other,
}

/// One kind of effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spec {
    /// The identity of the effect.
    pub kind: EffectKind,
    /// The number of its random stream ([`super::stream`]); 0 if it does not use random draws.
    pub stream: u16,
    /// The stage of the chain at which it acts.
    pub stage: Stage,
    /// How the effect shows in a record.
    pub nature: Nature,
    /// The parameters of the effect.
    pub parameters: &'static [Parameter],
    /// Sets of parameters of which exactly one is given; empty if there is no choice.
    pub forms: &'static [&'static [&'static str]],
    /// The meaning of the effect, in one sentence.
    pub meaning: &'static str,
    /// A few words with the main numbers, as `{size:.3e}`; `{more}` is the place for further effects of the kind. The
    /// first phrase whose numbers are not 0 is used, else the last one; without phrases, the name.
    pub phrases: &'static [&'static str],
}

/// An effect's table, and how an effect is made from a file's entry; `E` is the trait object.
pub struct Definition<E: ?Sized> {
    /// The table of the effect.
    pub spec: &'static Spec,
    /// Makes an effect from checked values.
    pub make: fn(&Values<'_>) -> Arc<E>,
}

impl<E: ?Sized> Definition<E> {
    /// Reads an effect from its entry's keys (without `effect`).
    ///
    /// # Errors
    /// [`Refusal`] for unknown and missing keys and for values outside their ranges.
    pub fn read(&self, entry: &Map<String, Value>) -> Result<Arc<E>, Refusal> {
        self.spec.check_map(entry)?;
        Ok((self.make)(&Values { spec: self.spec, map: entry }))
    }
}

impl Spec {
    /// Returns the name in files and messages.
    pub fn name(&self) -> &'static str {
        self.kind.name()
    }

    /// Returns whether the effect has the same density throughout a record.
    pub fn is_lasting(&self) -> bool {
        matches!(self.nature, Nature::White | Nature::Coloured)
    }

    /// Returns whether the values and stamps of a record show the effect without inference; otherwise it is noise or a
    /// level.
    pub fn is_fact(&self) -> bool {
        matches!(self.stage, Stage::Saturation | Stage::Resolution | Stage::Hold | Stage::Timing)
    }

    /// Returns the effect in a few words, with the main numbers of an entry; `more` are words about further effects of
    /// the kind.
    pub fn phrase(&self, entry: Option<&Value>, more: &str) -> String {
        let number = |name: &str| entry.and_then(|of| of.get(name)).and_then(Value::as_f64).unwrap_or_default();
        let holes =
            |phrase: &'static str| phrase.split(['{', '}']).skip(1).step_by(2).filter_map(|of| of.split_once(':'));
        let counts = |phrase: &&&'static str| holes(phrase).all(|(name, _)| number(name) != 0.0);
        let Some(phrase) = self.phrases.iter().find(counts).or(self.phrases.last()) else {
            return self.name().replace('_', " ");
        };
        let filled = holes(phrase).fold((*phrase).to_owned(), |text, (name, form)| {
            let (value, digits) = (number(name), form.trim_matches(['.', 'e']).parse().unwrap_or_default());
            let value = if form.ends_with('e') { format!("{value:.digits$e}") } else { format!("{value:.digits$}") };
            text.replace(&format!("{{{name}:{form}}}"), &value)
        });
        filled.replace("{more}", more)
    }

    /// Moves the times among an entry's parameters, of a list of entries, or of intervals in them.
    pub fn move_times(&self, entry: &mut Value, by_s: f64) {
        if let Value::Array(list) = entry {
            list.iter_mut().for_each(|of| self.move_times(of, by_s));
        }
        for parameter in self.parameters {
            let Some(value) = entry.get_mut(parameter.name) else { continue };
            match (parameter.form, value) {
                (Form::Time, Value::Array(ends)) => ends.iter_mut().for_each(|end| move_time(end, by_s)),
                (Form::Time, instant) => move_time(instant, by_s),
                (Form::Intervals | Form::Profile, Value::Array(pairs)) => {
                    let times = if parameter.form == Form::Profile { 1 } else { 2 };
                    let pairs = pairs.iter_mut().filter_map(Value::as_array_mut);
                    pairs.for_each(|pair| pair.iter_mut().take(times).for_each(|time| move_time(time, by_s)));
                }
                _ => {}
            }
        }
    }

    /// Checks whether the table allows `parameters`.
    pub(super) fn check(&self, parameters: &[(&'static str, Value)]) -> Result<(), Refusal> {
        self.check_map(&parameters.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect())
    }

    /// Returns the parameters' names.
    pub fn names(&self) -> Vec<&'static str> {
        self.parameters.iter().map(|parameter| parameter.name).collect()
    }

    /// Creates a refusal of one of the parameters.
    pub(super) fn refuse(
        &self,
        parameter: impl Into<String>,
        found: impl ToString,
        allowed: impl Into<String>,
    ) -> Refusal {
        Refusal { effect: self.kind, parameter: parameter.into(), found: found.to_string(), allowed: allowed.into() }
    }

    /// Refuses a frequency of half the rate or more.
    pub(super) fn below_nyquist(&self, parameter: &str, frequency_hz: f64, rate_hz: f64) -> Result<(), Refusal> {
        if frequency_hz < 0.5 * rate_hz {
            return Ok(());
        }
        let allowed = format!("a frequency below {} Hz, half the rate at which it acts", 0.5 * rate_hz);
        Err(self.refuse(parameter, format!("{frequency_hz} Hz"), allowed))
    }

    fn check_map(&self, entry: &Map<String, Value>) -> Result<(), Refusal> {
        let names = self.names();
        if let Some(unknown) = entry.keys().find(|key| !names.contains(&key.as_str())) {
            return Err(self.refuse(unknown.clone(), format!("the unknown key `{unknown}`"), self.keys_in_words()));
        }
        for parameter in self.parameters {
            match entry.get(parameter.name) {
                Some(value) => parameter.check(value).map_err(|(place, found, allowed)| {
                    self.refuse(format!("{}{place}", parameter.name), found, allowed)
                })?,
                None if parameter.need == Need::Always => {
                    let allowed = format!("`{}`: {}, {}", parameter.name, parameter.form.words(), parameter.meaning);
                    return Err(self.refuse(parameter.name, format!("no `{}`", parameter.name), allowed));
                }
                None => {}
            }
        }
        if self.forms.is_empty() {
            return Ok(());
        }
        let begun: Vec<_> =
            self.forms.iter().filter(|form| form.iter().any(|name| entry.contains_key(*name))).collect();
        let complete = |form: &[&'static str]| self.needed(form).iter().all(|name| entry.contains_key(*name));
        if begun.len() == 1 && begun.iter().all(|form| complete(form)) {
            return Ok(());
        }
        let found = entry.keys().map(|key| format!("`{key}`")).collect::<Vec<_>>().join(", ");
        let found = if found.is_empty() { "no parameter".to_owned() } else { found };
        Err(self.refuse(
            self.forms.first().and_then(|form| form.first()).copied().unwrap_or_default(),
            found,
            self.keys_in_words(),
        ))
    }

    /// Returns the parameters that a form requires.
    fn needed(&self, form: &[&'static str]) -> Vec<&'static str> {
        let optional = |name: &str| {
            let parameter = self.parameters.iter().find(|parameter| parameter.name == name);
            parameter.is_some_and(|of| of.default().is_some() || of.need == Need::Optional)
        };
        form.iter().copied().filter(|name| !optional(name)).collect()
    }

    fn keys_in_words(&self) -> String {
        if self.forms.is_empty() {
            return if self.parameters.is_empty() {
                "no key".to_owned()
            } else {
                format!("one of {}", self.names().join(", "))
            };
        }
        let words = |form: &&[&'static str]| {
            let needed = self.needed(form);
            let optional: Vec<_> = form.iter().copied().filter(|name| !needed.contains(name)).collect();
            let optional =
                if optional.is_empty() { String::new() } else { format!(", optionally {}", optional.join(", ")) };
            let always = self.parameters.iter().filter(|parameter| parameter.need == Need::Always).map(|of| of.name);
            format!("{}{optional}", always.chain(needed).collect::<Vec<_>>().join(" with "))
        };
        self.forms.iter().map(words).collect::<Vec<_>>().join("; or ")
    }

    /// Returns the JSON Schema of an entry.
    pub fn schema(&self) -> Value {
        let mut properties = Map::new();
        properties.insert("effect".to_owned(), json!({"const": self.name()}));
        let mut required = vec!["effect"];
        for parameter in self.parameters {
            let mut schema = parameter.form.schema();
            schema["description"] = json!(parameter.meaning);
            if let Some(default) = parameter.default() {
                schema["default"] = json!(default);
            }
            if parameter.need == Need::Always {
                required.push(parameter.name);
            }
            properties.insert(parameter.name.to_owned(), schema);
        }
        let mut schema = json!({
            "type": "object",
            "description": self.meaning,
            "properties": properties,
            "required": required,
            "additionalProperties": false,
        });
        if !self.forms.is_empty() {
            let of_others = |form: &[&'static str]| {
                let others = self.forms.iter().flat_map(|other| other.iter()).filter(|name| !form.contains(name));
                others.map(|name| json!({"required": [name]})).collect::<Vec<_>>()
            };
            let forms =
                self.forms.iter().map(|form| json!({"required": self.needed(form), "not": {"anyOf": of_others(form)}}));
            schema["oneOf"] = forms.collect();
        }
        schema
    }
}

/// The place inside the parameter, the value found, and the values allowed.
type Wrong = (String, String, String);

impl Parameter {
    fn check(&self, value: &Value) -> Result<(), Wrong> {
        let wrong = |place: String, found: &Value| (place, found.to_string(), self.form.words());
        let whole = || wrong(String::new(), value);
        let list = || value.as_array().filter(|list| !list.is_empty()).ok_or_else(whole);
        let pairs = || -> Result<Vec<(f64, f64)>, Wrong> {
            list()?
                .iter()
                .enumerate()
                .map(|(index, pair)| pair_of(pair).ok_or_else(|| wrong(format!("[{index}]"), pair)))
                .collect()
        };
        let at = |index: usize| wrong(format!("[{index}]"), &value[index]);
        let number = |range: Range| match value.as_f64() {
            Some(number) if range.contains(number) => Ok(()),
            found => Err((String::new(), value.to_string(), range.words_for(found))),
        };
        match self.form {
            Form::Number(range) => number(range),
            Form::Time => number(Range::FromZero),
            Form::Whole(from, to) => match whole_of(value) {
                Some(number) if (from..=to).contains(&number) => Ok(()),
                _ => Err(whole()),
            },
            Form::Numbers(range) => {
                let fits = |value: &Value| value.as_f64().is_some_and(|number| range.contains(number));
                list()?.iter().position(|value| !fits(value)).map_or(Ok(()), |index| Err(at(index)))
            }
            Form::Intervals => {
                let fits = |(from, to): &(f64, f64)| 0.0 <= *from && from < to && *to <= LARGEST;
                pairs()?.iter().position(|pair| !fits(pair)).map_or(Ok(()), |index| Err(at(index)))
            }
            Form::Profile | Form::Density => {
                let pairs = pairs()?;
                if pairs.len() < 2 {
                    return Err(whole());
                }
                let rises = |index: usize| index == 0 || pairs[index - 1].0 < pairs[index].0;
                let size = 0.0..=LARGEST;
                let fits =
                    |index: usize| size.contains(&pairs[index].0) && size.contains(&pairs[index].1) && rises(index);
                (0..pairs.len()).find(|index| !fits(*index)).map_or(Ok(()), |index| Err(at(index)))
            }
            Form::Effect(specs) => {
                let entry = value.as_object().ok_or_else(whole)?;
                let name = entry.get(EFFECT).unwrap_or(&Value::Null);
                let Some(spec) = specs.iter().find(|spec| name == spec.name()) else {
                    let names: Vec<_> = specs.iter().map(|spec| spec.name()).collect();
                    let allowed = format!("one of \"{}\"", names.join("\", \""));
                    return Err((format!(".{EFFECT}"), name.to_string(), allowed));
                };
                let own = entry.iter().filter(|(key, _)| *key != EFFECT);
                let own = own.map(|(key, value)| (key.clone(), value.clone())).collect();
                spec.check_map(&own).map_err(|of| (format!(".{}", of.parameter), of.found, of.allowed))
            }
            Form::Matrix => matrix_of(value).map(|_| ()).ok_or_else(whole),
            Form::Choice(words) => match value.as_str() {
                Some(word) if words.contains(&word) => Ok(()),
                _ => Err(whole()),
            },
        }
    }
}

impl Form {
    /// Returns a description for messages and tables.
    pub fn words(self) -> String {
        match self {
            Self::Number(range) => range.words(),
            Self::Time => Range::FromZero.words(),
            Self::Whole(from, to) => format!("a whole number from {from} to {to}"),
            Self::Numbers(range) => format!("a list of one or more, each {}", range.words()),
            Self::Intervals => "a list of one or more [from_s, to_s] with 0 ≤ from_s < to_s".to_owned(),
            Self::Profile => {
                "a list of two or more [t_s, factor] with rising times and factors, all of 0 or more".to_owned()
            }
            Self::Density => {
                "a list of two or more [f_hz, density] with rising frequencies and densities, all of 0 or more"
                    .to_owned()
            }
            Self::Effect(specs) => {
                let names: Vec<_> = specs.iter().map(|spec| spec.name()).collect();
                format!("an effect with its parameters, one of \"{}\"", names.join("\", \""))
            }
            Self::Matrix => "three rows of three numbers".to_owned(),
            Self::Choice(words) => format!("one of \"{}\"", words.join("\", \"")),
        }
    }

    fn schema(self) -> Value {
        let list = |items: Value, least: usize| json!({"type": "array", "items": items, "minItems": least});
        let exactly =
            |items: Value, count: usize| json!({"type": "array", "items": items, "minItems": count, "maxItems": count});
        match self {
            Self::Number(range) => range.schema(),
            Self::Time => Range::FromZero.schema(),
            Self::Whole(from, to) => json!({"type": "integer", "minimum": from, "maximum": to}),
            Self::Numbers(range) => list(range.schema(), 1),
            Self::Intervals => list(exactly(Range::FromZero.schema(), 2), 1),
            Self::Profile | Self::Density => list(exactly(Range::FromZero.schema(), 2), 2),
            Self::Effect(specs) => json!({"oneOf": specs.iter().map(|spec| spec.schema()).collect::<Vec<_>>()}),
            Self::Matrix => exactly(exactly(Range::Any.schema(), 3), 3),
            Self::Choice(words) => json!({"enum": words}),
        }
    }
}

fn whole_of(value: &Value) -> Option<u64> {
    // 4.0 is the whole number 4 in JSON.
    value.as_u64().or_else(|| value.as_f64().filter(|n| n.fract() == 0.0 && (0.0..1e15).contains(n)).map(|n| n as u64))
}

fn move_time(value: &mut Value, by_s: f64) {
    if let Some(time_s) = value.as_f64() {
        *value = (time_s + by_s).into();
    }
}

pub(super) fn pair_of(value: &Value) -> Option<(f64, f64)> {
    match value.as_array()?.as_slice() {
        [first, second] => Some((first.as_f64()?, second.as_f64()?)),
        _ => None,
    }
}

fn matrix_of(value: &Value) -> Option<[[f64; 3]; 3]> {
    let mut matrix = [[0.0; 3]; 3];
    let rows = value.as_array().filter(|rows| rows.len() == 3)?;
    for (row, places) in rows.iter().zip(&mut matrix) {
        let numbers = row.as_array().filter(|numbers| numbers.len() == 3)?;
        for (number, place) in numbers.iter().zip(places) {
            *place = number.as_f64().filter(|number| number.abs() <= LARGEST)?;
        }
    }
    Some(matrix)
}

/// An entry's values, after [`Spec`] has checked them.
#[derive(Debug)]
pub struct Values<'a> {
    spec: &'static Spec,
    map: &'a Map<String, Value>,
}

/// The key of an effect's name.
const EFFECT: &str = "effect";

impl Values<'_> {
    /// Returns the values of a parameter that is an effect.
    pub(super) fn effect(&self, name: &str) -> Option<Values<'_>> {
        let form = self.spec.parameters.iter().find(|parameter| parameter.name == name)?.form;
        let Form::Effect(specs) = form else { return None };
        let map = self.map.get(name)?.as_object()?;
        let spec = specs.iter().find(|spec| map.get(EFFECT).is_some_and(|name| name == spec.name()))?;
        Some(Values { spec, map })
    }
    /// Returns the effect whose values these are.
    pub(super) fn kind(&self) -> EffectKind {
        self.spec.kind
    }
    /// Returns the number, or its default.
    pub(super) fn number(&self, name: &str) -> f64 {
        self.optional(name).unwrap_or_else(|| {
            let parameter = self.spec.parameters.iter().find(|parameter| parameter.name == name);
            parameter.and_then(Parameter::default).unwrap_or_default()
        })
    }
    pub(super) fn optional(&self, name: &str) -> Option<f64> {
        self.map.get(name)?.as_f64()
    }
    pub(super) fn whole(&self, name: &str) -> u64 {
        self.map.get(name).and_then(whole_of).unwrap_or_else(|| self.number(name) as u64)
    }
    pub(super) fn numbers(&self, name: &str) -> Vec<f64> {
        self.map.get(name).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_f64).collect()
    }
    pub(super) fn pairs(&self, name: &str) -> Vec<(f64, f64)> {
        self.map.get(name).and_then(Value::as_array).into_iter().flatten().filter_map(pair_of).collect()
    }
    pub(super) fn matrix(&self, name: &str) -> [[f64; 3]; 3] {
        self.map.get(name).and_then(matrix_of).unwrap_or_default()
    }
    pub(super) fn word(&self, name: &str) -> &str {
        self.map.get(name).and_then(Value::as_str).unwrap_or_default()
    }
    pub(super) fn axes(&self) -> [f64; 3] {
        ["x", "y", "z"].map(|axis| self.number(axis))
    }
}
