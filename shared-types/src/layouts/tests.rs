use super::*;
use crate::ROLES;

/// A field as a compiler would place it.
#[derive(Clone)]
struct Node {
    name: String,
    kind: String,
    count: usize,
    fields: Vec<Node>,
}

impl Node {
    /// The fields of one topic, from its rows.
    fn sample(topic: Topic) -> Self {
        let rows = Layouts::built_in().rows.into_iter().filter(|row| row.topic == topic.name());
        let mut root = Self { name: String::new(), kind: String::new(), count: 1, fields: Vec::new() };
        for row in rows {
            if row.field == WHOLE {
                root.kind = row.kind;
                continue;
            }
            let mut around = &mut root;
            let mut names: Vec<&str> = row.field.split('.').collect();
            let name = names.pop().unwrap().to_owned();
            for outer in names {
                around = around.fields.iter_mut().find(|field| field.name == outer).unwrap();
            }
            around.fields.push(Self { name, kind: row.kind, count: row.count, fields: Vec::new() });
        }
        root
    }

    /// Alignment and size of one element, as the C compiler and Rust lay it out.
    fn layout(&self) -> (usize, usize) {
        let size = match self.kind.as_str() {
            "u8" => 1,
            "u16" => 2,
            "u32" | "i32" => 4,
            "u64" | "f64" => 8,
            _ => {
                let (mut end, mut largest) = (0usize, 1);
                for field in &self.fields {
                    let (align, size) = field.layout();
                    end = end.next_multiple_of(align) + size * field.count;
                    largest = largest.max(align);
                }
                return (largest, end.next_multiple_of(largest));
            }
        };
        (size, size)
    }

    fn rows(&self, topic: Topic) -> Layouts {
        let mut rows = Vec::new();
        self.add(topic, WHOLE, 0, &mut rows);
        Layouts { rows }
    }

    fn add(&self, topic: Topic, field: &str, offset: usize, rows: &mut Vec<LayoutRow>) {
        rows.push(LayoutRow {
            topic: topic.name().to_owned(),
            field: field.to_owned(),
            kind: self.kind.clone(),
            count: self.count,
            size: self.layout().1,
            offset,
        });
        let around = if field == WHOLE { String::new() } else { format!("{field}.") };
        let mut end = 0usize;
        for inner in &self.fields {
            let (align, size) = inner.layout();
            end = end.next_multiple_of(align);
            inner.add(topic, &format!("{around}{}", inner.name), offset + end, rows);
            end += size * inner.count;
        }
    }

    /// Paths of all fields, as indices.
    fn paths(&self) -> Vec<Vec<usize>> {
        let mut paths = Vec::new();
        for (index, field) in self.fields.iter().enumerate() {
            paths.push(vec![index]);
            paths.extend(field.paths().into_iter().map(|inner| [&[index][..], &inner].concat()));
        }
        paths
    }

    /// The struct around the last step of a path, and the name of the field it leads to.
    fn around(&mut self, path: &[usize]) -> (&mut Vec<Node>, String) {
        let (mut fields, mut name) = (&mut self.fields, String::new());
        for step in &path[..path.len() - 1] {
            name += &format!("{}.", fields[*step].name);
            fields = &mut fields[*step].fields;
        }
        name += &fields[path[path.len() - 1]].name;
        (fields, name)
    }
}

/// Ways in which another version of a sample may differ in one field.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Mutation {
    Rename,
    Reorder,
    Resize,
    Retype,
    Widen,
    Drop,
    Add,
}

/// A sample with one field changed, the name of that field, and the message about the difference; `None` where the
/// mutation makes no sense.
fn mutated(topic: Topic, path: &[usize], mutation: Mutation) -> Option<(Layouts, String, &'static str)> {
    let mut sample = Node::sample(topic);
    let (fields, name) = sample.around(path);
    let count = fields.len();
    let index = path[path.len() - 1];
    let field = fields.get_mut(index)?;
    let mut expected = name.clone();
    let says = match mutation {
        Mutation::Rename => {
            field.name += "_new";
            "is called"
        }
        Mutation::Reorder if index + 1 < count => {
            fields.swap(index, index + 1);
            "begins at byte"
        }
        Mutation::Reorder => return None,
        Mutation::Resize => {
            field.count += 2;
            "elements"
        }
        Mutation::Retype => {
            field.fields.clear();
            let other = match field.kind.as_str() {
                "u64" => "f64",
                "f64" => "u64",
                "u32" => "i32",
                "i32" => "u32",
                _ => "u8",
            };
            if field.kind == other {
                return None;
            }
            other.clone_into(&mut field.kind);
            "is of type"
        }
        Mutation::Widen if ["u8", "u16", "u32", "i32"].contains(&field.kind.as_str()) => {
            "u64".clone_into(&mut field.kind);
            "is of type u64"
        }
        Mutation::Widen => return None,
        Mutation::Drop => {
            fields.remove(index);
            "is missing"
        }
        Mutation::Add => {
            let node =
                Node { name: "added".to_owned(), kind: "f64".to_owned(), count: 1, fields: Vec::new() };
            fields.insert(index, node);
            let around = name.rsplit_once('.').map_or(String::new(), |(around, _)| format!("{around}."));
            expected = format!("{around}added");
            "is not in the samples"
        }
    };
    Some((sample.rows(topic), expected, says))
}

#[test]
fn one_field_changed_in_any_way_in_any_sample_is_found_by_its_name() {
    let theirs = Layouts::built_in();
    let mut tried = 0;
    for topic in TOPICS {
        for path in Node::sample(topic).paths() {
            for mutation in [
                Mutation::Rename,
                Mutation::Reorder,
                Mutation::Resize,
                Mutation::Retype,
                Mutation::Widen,
                Mutation::Drop,
                Mutation::Add,
            ] {
                let Some((mine, field, says)) = mutated(topic, &path, mutation) else { continue };
                let found = difference(&mine, &theirs, [topic]).unwrap();
                assert_eq!(
                    (found.topic.as_str(), &found.field),
                    (topic.name(), &field),
                    "{mutation:?}: {found}"
                );
                assert!(found.to_string().contains(says), "{mutation:?}: {found}");
                tried += 1;
            }
        }
    }
    assert!(tried >= 50, "{tried}");
}

#[test]
fn the_table_is_what_a_compiler_makes_of_the_fields() {
    let theirs = Layouts::built_in();
    for topic in TOPICS {
        let mine = Node::sample(topic).rows(topic);
        assert_eq!(difference(&mine, &theirs, [topic]), None);
        assert_eq!(mine.rows.iter().collect::<Vec<_>>(), theirs.of(topic.name()));
    }
}

#[test]
fn the_table_is_read_back_from_its_text_and_other_text_is_refused_by_its_line() {
    let layouts = Layouts::built_in();
    let text = layouts.to_string();
    assert_eq!(text.parse(), Ok(layouts));
    let line = |text: &str| text.parse::<Layouts>().unwrap_err().line;
    assert_eq!((line(""), line("layouts 7\n")), (1, 1));
    assert_eq!(line(&format!("{TITLE}\npose x_m f64 1 8\n")), 2);
    assert_eq!(line(&format!("{text}pose x_m f64 1 8 208 0\n")), text.lines().count() + 1);
}

#[test]
fn a_version_that_differs_in_nothing_but_its_name_is_refused_too() {
    let theirs = Layouts::built_in();
    let mut mine = theirs.clone();
    let row = mine.rows.iter_mut().find(|row| row.topic == "pose").unwrap();
    "scanloop.Pose.v5".clone_into(&mut row.kind);
    let found = difference(&mine, &theirs, TOPICS).unwrap();
    assert_eq!(
        found.to_string(),
        "topic pose: the sample is of type scanloop.Pose.v5 in this process, scanloop.Pose.v4 in the system"
    );
    mine.rows.retain(|row| row.topic != "pose");
    let found = difference(&mine, &theirs, TOPICS).unwrap();
    assert_eq!(found.to_string(), "topic pose: the sample is missing in this process");
}

#[test]
fn a_struct_with_room_behind_its_fields_is_named_itself() {
    let theirs = Layouts::built_in();
    let mut mine = theirs.clone();
    for row in mine.rows.iter_mut().filter(|row| row.topic == "command") {
        match row.field.as_str() {
            "plan" => row.size += 8,
            WHOLE => row.size += 200,
            _ => {}
        }
    }
    let found = difference(&mine, &theirs, TOPICS).unwrap();
    assert_eq!(found.to_string(), "topic command: field plan has 64 bytes in this process, 56 in the system");
}

#[test]
fn topics_that_a_role_has_nothing_to_do_with_are_not_compared() {
    let theirs = Layouts::built_in();
    let mut mine = theirs.clone();
    mine.rows.retain(|row| row.topic != "scan");
    let refused: Vec<Role> = Role::ALL
        .iter()
        .copied()
        .filter(|role| difference(&mine, &theirs, topics_of(*role)).is_some())
        .collect();
    assert_eq!(refused, [Role::Robot, Role::Estimator, Role::Obstacles]);
    assert_eq!(Role::ALL.len(), ROLES);
}
