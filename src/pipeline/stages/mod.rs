//! The stages: how are the sections of a pipeline file connected to the code that does the work?
