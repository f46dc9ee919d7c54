//! The layout of a message as data: the wire's fingerprint, the CSV columns and the twins' test are read from it.

/// One field of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// The field's name; its unit ends it.
    pub name: &'static str,
    /// Bytes from the start of the message.
    pub offset: usize,
    /// The type of one element.
    pub kind: Kind,
    /// Elements: 1, or the length of an array (of all its dimensions together).
    pub count: usize,
}

/// The type of one element of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// [`crate::Header`]
    Header,
    /// [`crate::Status`]
    Status,
    /// A byte.
    U8,
    /// An unsigned number of 4 bytes.
    U32,
    /// An unsigned number of 8 bytes.
    U64,
    /// A float of 4 bytes.
    F32,
    /// A float of 8 bytes.
    F64,
    /// UTF-8 text of this many bytes, filled up with zeros.
    Text(usize),
}

impl Kind {
    /// Bytes of one element.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::Header => 32,
            Self::U8 => 1,
            Self::Status | Self::U32 | Self::F32 => 4,
            Self::U64 | Self::F64 => 8,
            Self::Text(bytes) => bytes,
        }
    }

    /// The name of the type in a fingerprint.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Header => "header".into(),
            Self::Status => "status".into(),
            Self::U8 => "u8".into(),
            Self::U32 => "u32".into(),
            Self::U64 => "u64".into(),
            Self::F32 => "f32".into(),
            Self::F64 => "f64".into(),
            Self::Text(bytes) => format!("text{bytes}"),
        }
    }
}

impl Field {
    /// A field of one element.
    #[must_use]
    pub const fn new(name: &'static str, offset: usize, kind: Kind) -> Self {
        Self {
            name,
            offset,
            kind,
            count: 1,
        }
    }

    /// A field that is an array of `count` elements.
    #[must_use]
    pub const fn array(name: &'static str, offset: usize, kind: Kind, count: usize) -> Self {
        Self {
            name,
            offset,
            kind,
            count,
        }
    }

    /// Bytes from the start of the message to the end of this field.
    #[must_use]
    pub const fn end(&self) -> usize {
        self.offset + self.kind.size() * self.count
    }
}

/// True if the fields follow each other without a gap up to `size`: with a type that has no padding, none is forgotten.
#[must_use]
pub const fn covers(fields: &[Field], size: usize) -> bool {
    let mut end = 0;
    let mut index = 0;
    while index < fields.len() {
        if fields[index].offset != end {
            return false;
        }
        end = fields[index].end();
        index += 1;
    }
    end == size
}

/// The layout as text, one word a field: `Wheel/1 72 load_n:f64@32 …`. Two processes exchange samples only where
/// their texts are equal.
#[must_use]
pub fn fingerprint(name: &str, size: usize, fields: &[Field]) -> String {
    let mut text = format!("{name} {size}");
    for field in fields {
        text += &format!(" {}:{}", field.name, field.kind.name());
        if field.count > 1 {
            text += &format!("x{}", field.count);
        }
        text += &format!("@{}", field.offset);
    }
    text
}

/// What differs between two fingerprints, a line a field: `- ours` and `+ theirs`. Empty where they are equal.
#[must_use]
pub fn difference(ours: &str, theirs: &str) -> String {
    let mine: Vec<&str> = ours.split(' ').collect();
    let other: Vec<&str> = theirs.split(' ').collect();
    let missing = mine
        .iter()
        .filter(|word| !other.contains(word))
        .map(|word| format!("  - {word}"));
    let added = other
        .iter()
        .filter(|word| !mine.contains(word))
        .map(|word| format!("  + {word}"));
    missing.chain(added).collect::<Vec<_>>().join("\n")
}
