"""Python beside the program: `djinn.corpus` reads corpora, `djinn.export` writes them in formats of Python's world,
`djinn.convert` takes recordings from there, and `djinn.drive` connects planners with `djinn drive`."""
