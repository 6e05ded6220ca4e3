prt_test(isolate SOURCES unit/isolate.c LIBS prt_base LABELS unit)
