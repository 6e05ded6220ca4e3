prt_test(base SOURCES unit/base.c LIBS prt_base LABELS unit)
