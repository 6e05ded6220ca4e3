prt_test(resume SOURCES service/resume.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_resume PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_resume relightd prt_program)
