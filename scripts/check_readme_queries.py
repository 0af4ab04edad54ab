#!/usr/bin/env python3
"""Runs the example queries of the documents on corpora: do DuckDB, polars, pyarrow and pandas read what djinn writes?

    python3 scripts/check_readme_queries.py output/quickstart/main/corpus [MORE …]

Takes the SQL and Python blocks of README.md and schemas/README.md with the corpus in place of the quickstart's, and those of the
corpus's own card in its folder. Places must be text, whatever they are called. Only the first corpus must have all columns that are asked for: those of parameters are
of the behaviors in a corpus. What needs a package that is not installed
(pip install duckdb polars pyarrow pandas) is skipped, and said to be.
"""

import importlib.util
import os
import re
import sys
from pathlib import Path

QUICKSTART = "output/quickstart/main/corpus"


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def is_installed(package):
    if importlib.util.find_spec(package) is None:
        print(f"skipped: {package} is not installed")
        return False
    return True


def run_sql(text, place, has_all_columns):
    import duckdb

    for block in blocks(text, "sql"):
        for statement in filter(None, (part.strip() for part in block.replace(QUICKSTART, place).split(";"))):
            lines = [line for line in statement.splitlines() if not line.startswith("--")]
            try:
                rows = duckdb.sql("\n".join(lines))
            except duckdb.BinderException as error:
                if has_all_columns:
                    raise
                print(f"DuckDB: {str(error).splitlines()[0]}")
                continue
            table = rows.fetchall()
            print(f"DuckDB: {len(table)} rows of {', '.join(rows.columns)}")
            if "place" in rows.columns:
                check_places("DuckDB", [row[rows.columns.index("place")] for row in table])


def check_places(reader, places):
    """Readers guess the types of what folders are named for."""
    wrong = [place for place in places if not isinstance(place, str)]
    if wrong:
        sys.exit(f"{reader} reads the place {wrong[0]!r}, which is no text")


def places_of(table):
    """The column of places, if the table of some reader has one."""
    names = table.column_names if hasattr(table, "column_names") else table.columns
    if "place" not in names:
        return []
    column = table["place"]
    return column.to_pylist() if hasattr(column, "to_pylist") else list(column)


def run_python(text, place):
    for block in blocks(text, "python"):
        packages = re.findall(r"^import (\w+)", block, flags=re.MULTILINE)
        if not all(is_installed(package) for package in packages):
            continue
        names = {}
        exec(compile(block.replace(QUICKSTART, place), "README.md", "exec"), names)
        for name in [name for name in ("rates", "cut_ins", "tracks", "scenarios") if name in names]:
            table = names[name].collect() if hasattr(names[name], "collect") else names[name]
            table = table.to_table() if hasattr(table, "to_table") else table
            print(f"{packages[0]}: {name} has {len(table)} rows")
            check_places(packages[0], places_of(table))


def main():
    corpora = [Path(corpus).resolve() for corpus in sys.argv[1:]]
    for corpus in corpora:
        check(corpus, has_all_columns=corpus == corpora[0])


def check(corpus, has_all_columns):
    root = Path(__file__).resolve().parent.parent
    documents = [(root / "README.md", str(corpus)), (root / "schemas/README.md", str(corpus)), (corpus / "README.md", ".")]
    texts = [(document.read_text(encoding="utf-8"), place) for document, place in documents]
    os.chdir(corpus)
    has_duckdb = is_installed("duckdb")
    for text, place in texts:
        if has_duckdb:
            run_sql(text, place, has_all_columns)
        run_python(text, place)


if __name__ == "__main__":
    main()
