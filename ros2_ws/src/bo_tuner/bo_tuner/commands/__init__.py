"""The commands, a module each; `bo_tuner.executables` starts them."""
