"""The command line: parse, call one library function, report. One file a command."""
