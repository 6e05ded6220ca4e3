prt_test(ledger SOURCES unit/ledger.c LIBS relightd_rooms LABELS unit)
