// Two sides of one wire for tests, in one process: Cyclone keeps two domains apart, each with its
// own threads and sockets, that use the ports of the same domain. Samples between them are RTPS
// packets on the loopback interface. Test code only.
#ifndef RIPS_TESTS_SUPPORT_ROS2_TEST_WORLD_H_
#define RIPS_TESTS_SUPPORT_ROS2_TEST_WORLD_H_

#include <cstdlib>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"
#include "services/dds/participant.h"

namespace rips::dds {

// Sets CYCLONEDDS_URI while it lives.
class ScopedCycloneUri {
 public:
  explicit ScopedCycloneUri(const std::string& xml) {
    setenv("CYCLONEDDS_URI", xml.c_str(), /*overwrite=*/1);
  }
  ~ScopedCycloneUri() { unsetenv("CYCLONEDDS_URI"); }
  ScopedCycloneUri(const ScopedCycloneUri&) = delete;
  ScopedCycloneUri& operator=(const ScopedCycloneUri&) = delete;
};

// Below 101: the ports of higher domains (7400 + 250 x domain, DDSI-RTPS 2.5 §9.6.2.3) lie where
// Linux gives ports to others.
inline uint32_t RandomDomain() {
  static const uint32_t domain = 10 + std::random_device()() % 90;
  return domain;
}

// Tests that happen to run in the same domain at the same time do not see each other.
inline const std::string& Tag() {
  static const std::string& tag = *new std::string(absl::StrCat("test-", NewId()));
  return tag;
}

// CYCLONEDDS_URI of a domain, whatever its id, that is on the wire between them.
inline std::string WireUri() {
  return absl::StrCat(
      "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
      "multicast=\"true\"/></Interfaces></General><Discovery><ExternalDomainId>",
      RandomDomain(), "</ExternalDomainId><Tag>", Tag(),
      "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>");
}

class TestWorld : public ::testing::Test {
 protected:
  TestWorld() : near_(Side(1)), far_(Side(2)) {}

  Participant& near() { return *near_; }
  Participant& far() { return *far_; }
  // One more, once it is asked for.
  Participant& third() {
    if (third_ == nullptr) third_ = Side(3);
    return *third_;
  }
  // The other side vanishes.
  void DropFar() { far_.reset(); }

 private:
  static std::unique_ptr<Participant> Side(uint32_t id) {
    const ScopedCycloneUri uri(WireUri());
    absl::StatusOr<std::unique_ptr<Participant>> side = Participant::Create({.id = id});
    EXPECT_TRUE(side.ok()) << side.status();
    return *std::move(side);
  }

  std::unique_ptr<Participant> near_;
  std::unique_ptr<Participant> far_;
  std::unique_ptr<Participant> third_;
};

// True as soon as `condition` is; false if it is not within `limit`.
inline bool Eventually(const std::function<bool()>& condition,
                       absl::Duration limit = absl::Seconds(20)) {
  const absl::Time deadline = absl::Now() + limit;
  while (!condition()) {
    if (absl::Now() > deadline) return false;
    absl::SleepFor(absl::Milliseconds(2));
  }
  return true;
}

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_TEST_WORLD_H_
