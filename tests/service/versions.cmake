# Programs of the next version of baker and format: the same, but for the files in which the versions are.
# Their objects come before the libraries, whose own are then not taken.
set(next_files libprt/transport/open.c libprt/transport/write.c libprt/bake/checkpoint.c libprt/bake/row_store.c)
list(TRANSFORM next_files PREPEND ${CMAKE_SOURCE_DIR}/)
set(next_daemon_files core/main.c ops/bake_job.c ops/load_bake.c ops/shared_models.c store/catalogue.c store/models.c)
list(TRANSFORM next_daemon_files PREPEND ${CMAKE_SOURCE_DIR}/server/)
file(GLOB next_prt_files CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/libprt/tools/*.c)
add_executable(next_relightd ${next_daemon_files} ${next_files})
target_link_libraries(next_relightd PRIVATE prt_options relightd_rooms prt)
add_executable(next_prt ${next_prt_files} ${next_files})
target_compile_definitions(next_prt PRIVATE PRT_VERSION="${PROJECT_VERSION}")
target_link_libraries(next_prt PRIVATE prt_options prt prt_formats ${CJSON_LIBRARY} m)
foreach(program relightd prt)
  target_include_directories(next_${program} PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
  target_compile_definitions(next_${program} PRIVATE PRT_FILE_VERSION=3 PRT_BAKE_VERSION=7)
  set_target_properties(next_${program} PROPERTIES OUTPUT_NAME ${program}
    RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/next)
endforeach()
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
if(SYSTEM_PYTHON3 AND TARGET python_client)
  add_test(NAME versions COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/versions.py ${CMAKE_BINARY_DIR}/bin
    ${CMAKE_BINARY_DIR}/python ${CMAKE_BINARY_DIR}/next)
  set_tests_properties(versions PROPERTIES LABELS service SKIP_RETURN_CODE 77)
endif()
