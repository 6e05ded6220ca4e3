prt_test(harness SOURCES unit/harness.c LABELS unit)
