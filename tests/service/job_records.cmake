prt_test(job_records SOURCES service/job_records.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_job_records PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_job_records relightd prt_program)
