#include "ArmbridgeComponent.h"

#include "ArmbridgeConnection.h"
#include "ArmbridgeSubsystem.h"
#include "Engine/GameInstance.h"
#include "Engine/World.h"
#include "Misc/DateTime.h"

DEFINE_LOG_CATEGORY_STATIC(LogArmbridgeComponent, Log, All);

namespace
{
int64 NowMs()
{
	const FDateTime Now = FDateTime::UtcNow();
	return Now.ToUnixTimestamp() * 1000 + Now.GetMillisecond();
}
}

void UArmbridgeComponent::BeginPlay()
{
	Super::BeginPlay();
	UGameInstance* Game = GetWorld()->GetGameInstance();
	Connection = Game->GetSubsystem<UArmbridgeSubsystem>()->Connect(Url, Token);
	Connection->OnEvent.AddUObject(this, &UArmbridgeComponent::Handle);
}

void UArmbridgeComponent::EndPlay(const EEndPlayReason::Type Reason)
{
	if (Connection.IsValid())
	{
		Connection->OnEvent.RemoveAll(this);
		Connection.Reset();
	}
	Super::EndPlay(Reason);
}

bool UArmbridgeComponent::IsConnected() const
{
	return Connection.IsValid() && Connection->IsOpen();
}

bool UArmbridgeComponent::MoveToNamed(const FString& Target)
{
	return IsConnected() && Send(Connection->Arm.MoveToNamed(TCHAR_TO_UTF8(*Target)));
}

bool UArmbridgeComponent::MoveJoints(const TArray<FString>& Names, const TArray<float>& PositionsRad)
{
	std::vector<std::string> JointNames;
	for (const FString& Name : Names)
	{
		JointNames.push_back(TCHAR_TO_UTF8(*Name));
	}
	const std::vector<double> Positions(PositionsRad.GetData(), PositionsRad.GetData() + PositionsRad.Num());
	return IsConnected() && Send(Connection->Arm.MoveJoints(NowMs(), JointNames, Positions));
}

bool UArmbridgeComponent::MoveTip(const FVector& PositionCm)
{
	const Armbridge::FTriple Position = Armbridge::RosFromUnreal({PositionCm.X, PositionCm.Y, PositionCm.Z});
	return IsConnected() && Send(Connection->Arm.MoveTip(NowMs(), Position, nullptr));
}

bool UArmbridgeComponent::MoveTipToPose(const FVector& PositionCm, const FRotator& Rotation)
{
	const Armbridge::FTriple Position = Armbridge::RosFromUnreal({PositionCm.X, PositionCm.Y, PositionCm.Z});
	const FQuat Quaternion = Rotation.Quaternion();
	const Armbridge::FRotation Turned =
		Armbridge::MirroredRotation({Quaternion.X, Quaternion.Y, Quaternion.Z, Quaternion.W});
	return IsConnected() && Send(Connection->Arm.MoveTip(NowMs(), Position, &Turned));
}

bool UArmbridgeComponent::MoveGripper(float PositionRad, float MaxEffort)
{
	return IsConnected() && Send(Connection->Arm.MoveGripper(PositionRad, MaxEffort));
}

bool UArmbridgeComponent::Stop()
{
	return Connection.IsValid() && Connection->Send(Armbridge::FArm::Stop());
}

bool UArmbridgeComponent::Send(const Armbridge::FRequest& Request)
{
	if (!Request.Error.empty())
	{
		UE_LOG(LogArmbridgeComponent, Warning, TEXT("%s"), UTF8_TO_TCHAR(Request.Error.c_str()));
		return false;
	}
	return Connection->Send(Request.Frame);
}

void UArmbridgeComponent::Handle(const Armbridge::FEvent& Event)
{
	using EKind = Armbridge::FEvent::EKind;
	const FString Message(UTF8_TO_TCHAR(Event.Message.c_str()));
	if (Event.Kind == EKind::Joints)
	{
		TArray<FString> Names;
		TArray<float> PositionsRad;
		for (size_t Joint = 0; Joint < Event.Names.size(); ++Joint)
		{
			Names.Add(UTF8_TO_TCHAR(Event.Names[Joint].c_str()));
			PositionsRad.Add(static_cast<float>(Event.PositionsRad[Joint]));
		}
		OnJoints.Broadcast(Names, PositionsRad);
	}
	else if (Event.Kind == EKind::GoalEnded)
	{
		OnGoalEnded.Broadcast(Event.Code, Message);
	}
	else if (Event.Kind == EKind::GripperEnded)
	{
		OnGripperEnded.Broadcast(Event.Code == 1, Message);
	}
}
