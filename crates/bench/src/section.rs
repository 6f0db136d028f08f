//! A section of a report, written as Markdown, CSV or HTML.

use std::fmt::Write as _;

/// A table with what stands above and below it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Section {
    /// Line above the table in Markdown; none when empty.
    pub title: String,
    /// Heads of the columns; no table in Markdown and no head in HTML when empty.
    pub columns: Vec<String>,
    /// Cells, as many as columns in every row.
    pub rows: Vec<Vec<String>>,
    /// Paragraphs and lists below the table in Markdown.
    pub notes: Vec<String>,
}

impl Section {
    /// A table alone.
    pub(crate) fn table<C: Into<String>>(
        columns: impl IntoIterator<Item = C>,
        rows: impl IntoIterator<Item = Vec<String>>,
    ) -> Self {
        Self {
            columns: columns.into_iter().map(Into::into).collect(),
            rows: rows.into_iter().collect(),
            ..Self::default()
        }
    }

    /// Notes alone.
    pub(crate) fn notes(notes: Vec<String>) -> Self {
        Self { notes, ..Self::default() }
    }

    /// With a line above it.
    pub(crate) fn titled(self, title: impl Into<String>) -> Self {
        Self { title: title.into(), ..self }
    }

    /// A document of sections under a heading.
    pub(crate) fn markdown(heading: &str, sections: impl IntoIterator<Item = Self>) -> String {
        let mut text = format!("# {heading}\n");
        let blocks = sections.into_iter().flat_map(|section| {
            let table = section.markdown_table();
            std::iter::once(section.title).chain([table]).chain(section.notes)
        });
        for block in blocks.filter(|block| !block.is_empty()) {
            let _ = write!(text, "\n{block}\n");
        }
        text
    }

    fn markdown_table(&self) -> String {
        if self.columns.is_empty() {
            return String::new();
        }
        let line = |cells: &[String]| format!("| {} |", cells.join(" | "));
        let head = [line(&self.columns), "|--".repeat(self.columns.len()) + "|"];
        head.into_iter().chain(self.rows.iter().map(|row| line(row))).collect::<Vec<_>>().join("\n")
    }

    /// Columns and rows. Cells have no commas.
    pub(crate) fn csv(&self) -> String {
        let lines = std::iter::once(&self.columns).chain(&self.rows);
        lines.map(|cells| cells.join(",") + "\n").collect()
    }

    /// The table alone.
    pub(crate) fn html(&self) -> String {
        let head = (!self.columns.is_empty()).then_some((&self.columns, "th"));
        let rows = head.into_iter().chain(self.rows.iter().map(|row| (row, "td")));
        let line = |(cells, tag): (&Vec<String>, &str)| html_row(tag, cells.iter().map(|cell| escaped(cell)));
        format!("<table>{}</table>\n", rows.map(line).collect::<String>())
    }
}

/// A row of an HTML table whose cells are HTML; `tag` is that of a cell.
pub(crate) fn html_row(tag: &str, cells: impl IntoIterator<Item = String>) -> String {
    let cells = cells.into_iter().map(|cell| format!("<{tag}>{cell}</{tag}>"));
    format!("<tr>{}</tr>\n", cells.collect::<String>())
}

/// Text as HTML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_section_in_three_forms() {
        let rows = [vec!["a<b".to_owned(), "1".to_owned()], vec!["c".to_owned(), "2".to_owned()]];
        let section = Section::table(["name", "n"], rows).titled("Counts:");
        assert_eq!(section.csv(), "name,n\na<b,1\nc,2\n");
        let rows = "<tr><td>a&lt;b</td><td>1</td></tr>\n<tr><td>c</td><td>2</td></tr>\n";
        let head = "<tr><th>name</th><th>n</th></tr>\n";
        assert_eq!(section.html(), format!("<table>{head}{rows}</table>\n"));
        let headless = Section { columns: Vec::new(), ..section.clone() };
        assert_eq!(headless.html(), format!("<table>{rows}</table>\n"));
        let text =
            Section::markdown("Title", [section, Section::notes(vec!["* x\n* y".into(), "End.".into()])]);
        let table = "| name | n |\n|--|--|\n| a<b | 1 |\n| c | 2 |";
        assert_eq!(text, format!("# Title\n\nCounts:\n\n{table}\n\n* x\n* y\n\nEnd.\n"));
    }
}
