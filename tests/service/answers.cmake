# Details of a live relightd's answers.
prt_test(answers SOURCES service/answers.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_answers PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service ${CMAKE_SOURCE_DIR}/libprt/include)
add_dependencies(test_answers relightd prt_program)
