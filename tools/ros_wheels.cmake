# Included at the end of every project() call by `tools/setup` (CMAKE_PROJECT_INCLUDE) when ROS 2 comes from PyPI wheels.
#
# The wheels were built in a manylinux container, and their exported CMake targets still name its Python
# (/opt/python/cp3*/include/...). CMake stops at an include directory that does not exist, so those entries are dropped;
# the headers of the Python that runs the build are found by find_package(Python3) anyway.

function(_drop_manylinux_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(kept)
    foreach(directory IN LISTS directories)
      if(NOT directory MATCHES "^/opt/python/" OR EXISTS "${directory}")
        list(APPEND kept "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()

# Deferred to the end of the directory, when find_package() has made all imported targets.
cmake_language(DEFER CALL _drop_manylinux_include_directories)
