"""Binary logs: a module for what a file is made of and a compiled parser for each format."""
