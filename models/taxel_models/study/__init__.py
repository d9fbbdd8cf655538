"""The paper's study on any recording: folds, cells, significance, tables and pictures."""
