prt_test(zip SOURCES unit/zip.c ${CMAKE_SOURCE_DIR}/client/cli/zip.c LIBS z LABELS unit)
target_include_directories(test_zip PRIVATE ${CMAKE_SOURCE_DIR}/client)
