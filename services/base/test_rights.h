// Which rights of root a test has: in a container, root may lack some.
#ifndef RIPS_SERVICES_BASE_TEST_RIGHTS_H_
#define RIPS_SERVICES_BASE_TEST_RIGHTS_H_

#include <linux/capability.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <initializer_list>

namespace rips {

// True for root with all these capabilities, such as CAP_CHOWN.
inline bool RootMay(std::initializer_list<int> capabilities) {
  __user_cap_header_struct header = {_LINUX_CAPABILITY_VERSION_3, 0};
  __user_cap_data_struct data[_LINUX_CAPABILITY_U32S_3] = {};
  if (geteuid() != 0 || syscall(SYS_capget, &header, data) != 0) return false;
  for (const int each : capabilities) {
    if ((data[CAP_TO_INDEX(each)].effective & CAP_TO_MASK(each)) == 0) return false;
  }
  return true;
}

// Root as it is outside of containers, as far as files and processes of other users go.
inline bool RootMayActForOthers() {
  return RootMay({CAP_CHOWN, CAP_DAC_OVERRIDE, CAP_FOWNER, CAP_KILL, CAP_SETGID, CAP_SETUID});
}

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_TEST_RIGHTS_H_
