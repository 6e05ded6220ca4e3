# The prt program. The interface library of the same name gathers the rooms.
file(GLOB prt_program_sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_LIST_DIR}/*.c)
find_library(CJSON_LIBRARY cjson REQUIRED)
add_executable(prt_program ${prt_program_sources})
set_target_properties(prt_program PROPERTIES OUTPUT_NAME prt)
target_compile_definitions(prt_program PRIVATE PRT_VERSION="${PROJECT_VERSION}")
target_link_libraries(prt_program PRIVATE prt_options prt prt_formats ${CJSON_LIBRARY} m)
install(TARGETS prt_program RUNTIME DESTINATION bin)
include(${CMAKE_CURRENT_LIST_DIR}/bench/bench.cmake OPTIONAL)
