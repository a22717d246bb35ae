#include "services/rpc/reading_pace.h"

#include <algorithm>
#include <ctime>

namespace rips::rpc {
namespace {

int64_t Now(clockid_t clock) {
  timespec now = {};
  clock_gettime(clock, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

}  // namespace

ReadingCost::ReadingCost(size_t bytes)
    : bytes_(bytes),
      began_ns_(Now(bytes < kShortBytes ? CLOCK_MONOTONIC : CLOCK_THREAD_CPUTIME_ID)) {}

int64_t ReadingCost::Take() const {
  const int64_t transport_ns = kTransportNs + static_cast<int64_t>(bytes_ / kTransportBytesPerNs);
  if (bytes_ >= kShortBytes) return transport_ns + Now(CLOCK_THREAD_CPUTIME_ID) - began_ns_;
  const int64_t most_ns = kMessageNs + static_cast<int64_t>(bytes_) * kByteNs;
  return transport_ns + std::min(Now(CLOCK_MONOTONIC) - began_ns_, most_ns);
}

ReadingPace::Next ReadingPace::OnRead(int64_t took_ns, int64_t now_ns) {
  MutexLock lock(&mu_);
  budget_.Spent(now_ns);  // what has flowed in is there before this is charged
  budget_.Charge(took_ns);
  last_ns_ = now_ns;
  if (!budget_.Spent(now_ns)) return Next::kRead;
  if (news_ns_ && now_ns - *news_ns_ < limits_.again_ns) return Next::kPause;
  news_ns_ = now_ns;
  return Next::kPauseIsNews;
}

bool ReadingPace::MayRead(int64_t now_ns) {
  MutexLock lock(&mu_);
  return !budget_.Spent(now_ns);
}

bool ReadingPace::Forgotten(int64_t now_ns) const {
  MutexLock lock(&mu_);
  return now_ns - last_ns_ >= limits_.again_ns;
}

std::shared_ptr<ReadingPace> ReadingPaces::Of(const std::string& agent, int64_t now_ns) {
  MutexLock lock(&mu_);
  std::shared_ptr<ReadingPace>& pace = paces_[agent];
  if (pace == nullptr) pace = std::make_shared<ReadingPace>(limits_, now_ns);
  return pace;
}

void ReadingPaces::Prune(int64_t now_ns) {
  MutexLock lock(&mu_);
  absl::erase_if(paces_, [now_ns](const auto& each) {
    return each.second.use_count() == 1 && each.second->Forgotten(now_ns);
  });
}

size_t ReadingPaces::size() const {
  MutexLock lock(&mu_);
  return paces_.size();
}

}  // namespace rips::rpc
