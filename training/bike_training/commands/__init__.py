"""One module a subcommand of `bike`, with `configure(parser)` and `run(args)`."""
