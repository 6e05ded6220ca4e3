prt_test(import_list SOURCES unit/import_list.c LIBS relightd_rooms LABELS unit TIMEOUT 60)
