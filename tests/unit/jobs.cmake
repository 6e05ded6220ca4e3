prt_test(jobs SOURCES unit/jobs.c LIBS relightd_rooms LABELS unit)
