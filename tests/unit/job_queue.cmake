prt_test(job_queue SOURCES unit/job_queue.c LIBS relightd_rooms LABELS unit)
