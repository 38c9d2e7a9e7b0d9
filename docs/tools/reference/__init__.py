"""The pages of docs/reference, each a function without arguments that gives its Markdown."""
