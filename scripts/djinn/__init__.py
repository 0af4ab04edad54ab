"""Python beside the program: `djinn.corpus` reads corpora, `djinn.export` writes them in formats of Python's world, and
`djinn.drive` connects planners with `djinn drive`."""
