"""The control law as C99: the lines of `firmware_model.law`, translated, compiled, and run.

`source` reads a module, `subset` gives everything a type and refuses the rest, `effects` refuses
what C would compute in another order, `c_files` writes C; `law` and `application`
are the files of an export, `boards` emulates boards. `trials`, `costs` and `findings` are evidence.
Imported by `cli` and `controllers`; the package imports `scenario` and lower rooms.
"""
