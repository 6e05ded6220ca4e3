prt_test(work SOURCES unit/work.c LIBS relightd_rooms LABELS unit)
