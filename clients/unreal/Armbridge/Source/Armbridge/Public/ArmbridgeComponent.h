#pragma once

#include "Components/ActorComponent.h"
#include "CoreMinimal.h"

#include "ArmbridgeComponent.generated.h"

class FArmbridgeConnection;
namespace Armbridge
{
struct FEvent;
struct FRequest;
}

DECLARE_DYNAMIC_MULTICAST_DELEGATE_TwoParams(FArmbridgeJoints, const TArray<FString>&, Names, const TArray<float>&, PositionsRad);
DECLARE_DYNAMIC_MULTICAST_DELEGATE_TwoParams(FArmbridgeGoal, int32, Code, const FString&, Message);
DECLARE_DYNAMIC_MULTICAST_DELEGATE_TwoParams(FArmbridgeGripper, bool, bDone, const FString&, Message);

/**
 * Moves the arm of a server. Functions return false while not connected; a new goal takes the place of the one before.
 * All functions and events run on the game thread.
 */
UCLASS(ClassGroup = (Robotics), meta = (BlueprintSpawnableComponent))
class ARMBRIDGE_API UArmbridgeComponent : public UActorComponent
{
	GENERATED_BODY()

public:
	UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "armbridge")
	FString Url = TEXT("ws://127.0.0.1:9090");

	/** Authentication token; empty if the server requires none. */
	UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "armbridge")
	FString Token;

	/** Measured joint positions, 25 times a second. */
	UPROPERTY(BlueprintAssignable, Category = "armbridge")
	FArmbridgeJoints OnJoints;

	/** The end of the latest goal: MoveIt's error code, 1 for success, and a sentence. */
	UPROPERTY(BlueprintAssignable, Category = "armbridge")
	FArmbridgeGoal OnGoalEnded;

	/** The end of the latest gripper command: true if the gripper is there or holds something, and a sentence. */
	UPROPERTY(BlueprintAssignable, Category = "armbridge")
	FArmbridgeGripper OnGripperEnded;

	UFUNCTION(BlueprintPure, Category = "armbridge")
	bool IsConnected() const;

	/** Moves to a named target, such as "ready". */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool MoveToNamed(const FString& Target);

	/** Moves some joints [rad]; the others stay. */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool MoveJoints(const TArray<FString>& Names, const TArray<float>& PositionsRad);

	/** Moves the tip to a point relative to the arm's base, in Unreal's axes [cm]. */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool MoveTip(const FVector& PositionCm);

	/** Moves the tip to a pose relative to the arm's base; an SO-101's five joints cannot reach each one. */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool MoveTipToPose(const FVector& PositionCm, const FRotator& Rotation);

	/** Moves the gripper's joint [rad], with at most this share of its torque (0: the server's own). */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool MoveGripper(float PositionRad, float MaxEffort);

	/** Stops the arm along its path and ends all goals. */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool Stop();

protected:
	virtual void BeginPlay() override;
	virtual void EndPlay(const EEndPlayReason::Type Reason) override;

private:
	bool Send(const Armbridge::FRequest& Request);
	void Handle(const Armbridge::FEvent& Event);

	TSharedPtr<FArmbridgeConnection> Connection;
};
