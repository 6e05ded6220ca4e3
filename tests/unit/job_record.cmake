prt_test(job_record SOURCES unit/job_record.c LIBS relightd_rooms LABELS unit)
