prt_test(errors SOURCES unit/errors.c LIBS relightd_rooms LABELS unit)
