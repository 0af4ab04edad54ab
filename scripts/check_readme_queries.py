#!/usr/bin/env python3
"""Runs the example queries of the documents on a corpus: do DuckDB, polars, pyarrow and pandas read what djinn writes?

    python3 scripts/check_readme_queries.py output/quickstart/main/corpus

Takes the SQL and Python blocks of README.md and schemas/README.md with the corpus in place of the quickstart's, and those of the
corpus's own card in its folder. What needs a package that is not installed (pip install duckdb polars pyarrow pandas) is skipped, and said to be.
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


def run_sql(text, place):
    import duckdb

    for block in blocks(text, "sql"):
        for statement in filter(None, (part.strip() for part in block.replace(QUICKSTART, place).split(";"))):
            lines = [line for line in statement.splitlines() if not line.startswith("--")]
            rows = duckdb.sql("\n".join(lines))
            print(f"DuckDB: {len(rows.fetchall())} rows of {', '.join(rows.columns)}")


def run_python(text, place):
    for block in blocks(text, "python"):
        packages = re.findall(r"^import (\w+)", block, flags=re.MULTILINE)
        if not all(is_installed(package) for package in packages):
            continue
        names = {}
        exec(compile(block.replace(QUICKSTART, place), "README.md", "exec"), names)
        for name in [name for name in ("rates", "cut_ins", "tracks", "scenarios") if name in names]:
            table = names[name].collect() if hasattr(names[name], "collect") else names[name]
            rows = table.count_rows() if hasattr(table, "count_rows") else len(table)
            print(f"{packages[0]}: {name} has {rows} rows")


def main():
    corpus = Path(sys.argv[1]).resolve()
    root = Path(__file__).resolve().parent.parent
    documents = [(root / "README.md", str(corpus)), (root / "schemas/README.md", str(corpus)), (corpus / "README.md", ".")]
    texts = [(document.read_text(encoding="utf-8"), place) for document, place in documents]
    os.chdir(corpus)
    has_duckdb = is_installed("duckdb")
    for text, place in texts:
        if has_duckdb:
            run_sql(text, place)
        run_python(text, place)


if __name__ == "__main__":
    main()
