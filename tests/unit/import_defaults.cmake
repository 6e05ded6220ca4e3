prt_test(import_defaults SOURCES unit/import_defaults.c LIBS prt_medium LABELS unit)
