prt_test(service SOURCES service/service.c LIBS librelight LABELS service TIMEOUT 400)
target_include_directories(test_service PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_service relightd prt_program)
