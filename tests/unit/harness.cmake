prt_test(harness SOURCES unit/harness.c LIBS librelight LABELS unit)
